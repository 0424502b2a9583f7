// Requests to the server. Errors have the one line of the server's answer.
import { emit, report, settle } from "./state.js";

const MAX_UPLOAD_BYTES = 100e6;
const KEY = "skyline-session";
const others = new BroadcastChannel("skyline"); // the page in other tabs
const GONE = 404;
const AGAIN_MS = 1500;
const NO_ANSWER = "The server does not answer; is `skyline serve` still running? The page goes on when it is back, and keeps what you draw.";
let session = null;
let socket = null;
let restored = null; // opens the page's photos in a new session
let isNew = false; // whether the page's photos are still to be opened in the session

async function ask(method, path, body) {
  let answer;
  try {
    answer = await fetch(path, { method, body });
  } catch {
    throw Object.assign(new Error(NO_ANSWER), { kind: "server" });
  }
  settle("server");
  if (answer.ok) return answer;
  let reason = null;
  try {
    reason = (await answer.json()).error;
  } catch {
    // The answer has no message.
  }
  const error = new Error(reason || `the server answers with status ${answer.status}`);
  throw Object.assign(error, { status: answer.status });
}

export const current = () => session;
export const isOpen = (photo) => photo.session === session;
const inSession = (path) => `session/${session}/${path}`;
const ofPhoto = (photo, path) => inSession(`photos/${photo.id}${path}`);

// Returns the photos of the page's session, none if the session is new. After a restart of the
// server there is a new session, and ``restore`` is called to open the photos again.
export async function begin(restore) {
  restored = restore;
  session = localStorage.getItem(KEY);
  others.onmessage = ({ data }) => data === session && emit("elsewhere");
  const kept = (session && (await records().catch(() => null))) || (await renew());
  listen();
  return kept;
}

async function renew() {
  const begun = await (await ask("POST", "session")).json();
  ({ session } = begun);
  localStorage.setItem(KEY, session);
  return begun.photos;
}

// Tells the other tabs that photos, strokes or results have changed.
export const tellOthers = () => others.postMessage(session);

export const records = async () => (await (await ask("GET", `session/${session}`)).json()).photos;
export const about = async () => (await ask("GET", "state")).json();

export const names = async (area) => (await ask("GET", `names/${area.id}`)).json();

export async function upload(file) {
  if (file.size > MAX_UPLOAD_BYTES) {
    const size = (file.size / 1e6).toFixed(0);
    throw new Error(`${file.name} has ${size} MB; the page takes at most 100 MB: save it smaller`);
  }
  const bytes = await file.arrayBuffer().catch(() => {
    throw new Error(`${file.name} cannot be read; it is a folder, or has changed: choose the photo again`);
  });
  return opened(`photos?name=${encodeURIComponent(file.name)}`, bytes);
}

export const openGiven = (index) => opened(`given/${index}`);
const opened = async (path, body) => ({ ...(await (await ask("POST", inSession(path), body)).json()), session });
export const remove = (photo) => ask("DELETE", ofPhoto(photo, ""));
export const picture = async (photo) => (await ask("GET", ofPhoto(photo, "/picture"))).blob();
export const cancel = (photo) => ask("DELETE", ofPhoto(photo, "/match"));

const asSkyline = async (photo, answer) => {
  const lines = new Float32Array(await answer.arrayBuffer());
  const width = lines.length / 3;
  return {
    trace: await (await ask("GET", ofPhoto(photo, "/trace"))).text(),
    rows: lines.subarray(0, width),
    trust: lines.subarray(width, 2 * width),
    others: lines.subarray(2 * width),
    lacks: answer.headers.get("Skyline-Lacks"),
    version: answer.headers.get("ETag").replaceAll('"', ""),
  };
};

export const skyline = async (photo, strokes) =>
  asSkyline(photo, await ask("POST", ofPhoto(photo, "/skyline"), JSON.stringify(strokes ? { strokes } : {})));
export const project = async (photo, projection) =>
  asSkyline(photo, await ask("POST", ofPhoto(photo, "/skyline"), JSON.stringify({ projection })));
// Puts a trace under the strokes, which are gone then; without a trace, the photo's own skyline.
export const startFrom = async (photo, trace) =>
  asSkyline(photo, await ask(trace ? "POST" : "DELETE", ofPhoto(photo, "/trace"), trace ?? undefined));
export const match = async (photo, known) =>
  (await ask("POST", ofPhoto(photo, "/match"), JSON.stringify(known))).json();
export const fit = async (photo, pose, known) =>
  (await ask("POST", ofPhoto(photo, "/fit"), JSON.stringify({ pose, known }))).json();
export const save = async (photo, kind, what) =>
  (await ask("POST", ofPhoto(photo, `/save/${kind}`), JSON.stringify(what))).blob();

function listen() {
  const address = new URL(inSession("live"), location.href);
  address.protocol = "ws:";
  socket = new WebSocket(address);
  socket.onopen = () => emit("connected");
  socket.onmessage = (event) => {
    const message = JSON.parse(event.data);
    emit(message.type, message);
  };
  socket.onclose = () => reconnect();
}

async function reconnect(isFirst = true) {
  try {
    await records().catch(async (error) => {
      if (error.status !== GONE) throw error;
      // Another tab may have begun a session already.
      const theirs = localStorage.getItem(KEY);
      if (theirs === session) await renew();
      else session = theirs;
      isNew = true;
    });
    if (isNew) await restored();
    isNew = false;
    listen();
  } catch (error) {
    if (isFirst) report(error, "server");
    setTimeout(reconnect, AGAIN_MS, false);
  }
}

export function send(asked) {
  if (socket?.readyState !== WebSocket.OPEN) return false;
  socket.send(JSON.stringify(asked));
  return true;
}

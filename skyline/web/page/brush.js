// Strokes over the photo; the skyline is found again after each.
import * as server from "./server.js";
import { $, ARROWS, alertUser, emit, on, report, settle, showStatus, state, toView } from "./state.js";
import { keep } from "./kept.js";
import { draw, fit, inPhoto, keepInView, marks, pan, view, zoom } from "./view.js";
import { release, turnBy } from "./hand.js";

const canvas = $("photo");
const PAINTS = ["sky", "ground", "line", "erase"];
const KEYS = { m: "move", s: "sky", g: "ground", l: "line", e: "erase", t: "turn" };
const undone = [];
const unsent = new Set(); // photos with strokes that the server has not seen
let solving = false;
let dragged = null; // what the drag under way does

const tool = () => document.querySelector("input[name=tool]:checked").value;
const radius = () => (tool() === "line" ? 0 : Number($("brush").value) / view.scale / 2);

function choose(name) {
  document.querySelector(`input[name=tool][value=${name}]`).checked = true;
  chosen();
}

function chosen() {
  marks.brush = PAINTS.includes(tool()) ? Math.max(radius(), 2 / view.scale) : 0;
  canvas.style.cursor = marks.brush ? "crosshair" : tool() === "turn" ? "ew-resize" : "grab";
  // One finger works with a tool; without one it scrolls a phone's page.
  canvas.style.touchAction = tool() === "move" ? "" : "none";
  draw();
}

const rounded = (place) => place.map((one) => Number(one.toFixed(2)));

function begin(at) {
  marks.stroke = { kind: tool(), radius: radius(), points: [rounded(at)] };
}

function finish() {
  const stroke = marks.stroke;
  marks.stroke = null;
  if (!stroke) return;
  undone.length = 0;
  state.photo.strokes.push(stroke);
  solve();
}

function undo() {
  const { photo } = state;
  if (photo?.strokes?.length) {
    undone.push(photo.strokes.pop());
    solve();
  } else if (photo?.before) {
    const { trace } = photo;
    startFrom(photo, photo.before, () => undone.push({ trace }));
  }
}

function redo() {
  const { photo } = state;
  const last = undone.pop();
  if (!last) return;
  if (last.kind) {
    photo.strokes.push(last);
    solve();
  } else {
    startFrom(photo, loaded(photo, last.trace), () => {});
  }
}

// The work on a photo after a trace was loaded; the work before it is kept for undo.
const loaded = ({ strokes, trace, before }, text) => ({ strokes: [], trace: text, before: { strokes, trace, before } });

async function startFrom(photo, work, done) {
  try {
    await server.startFrom(photo, work.trace);
  } catch (error) {
    return report(error, "trace");
  }
  Object.assign(photo, work, { solved: 0 });
  if (photo !== state.photo) return unsent.add(photo) && send();
  done();
  solve();
}

function solve() {
  buttons();
  keep(state.photo);
  unsent.add(state.photo);
  draw();
  send();
}

// One request at a time; strokes drawn meanwhile go with the next. Without a server they wait.
async function send() {
  if (solving) return;
  solving = true;
  while (unsent.size) {
    const [photo] = unsent;
    const strokes = [...photo.strokes];
    const began = performance.now();
    if (!state.photos.includes(photo)) {
      unsent.delete(photo);
      continue;
    }
    try {
      const skyline = await server.skyline(photo, strokes);
      photo.solved = strokes.length;
      if (isSame(strokes, photo.strokes)) unsent.delete(photo);
      performance.measure("stroke", { start: began });
      settle("strokes");
      emit("mended");
      if (photo !== state.photo) continue;
      showSkyline(skyline);
      showShare();
    } catch (error) {
      report(error, "strokes");
      if (error.kind === "server") break;
      unsent.delete(photo);
    }
  }
  solving = false;
}

const isSame = (some, others) => some.length === others.length && some.every((one, k) => one === others[k]);

export const waits = (photo) => unsent.has(photo);

// Resumes the work on a photo that the server does not know.
export async function resume(photo, { strokes, trace }) {
  Object.assign(photo, { strokes, trace });
  if (trace) await server.startFrom(photo, trace);
  const count = strokes.length;
  if (count) await server.skyline(photo, strokes);
  photo.solved = count;
  if (count === strokes.length) unsent.delete(photo);
}

export function showShare(before = "Skyline") {
  const share = state.rows.reduce((sum, row) => sum + !Number.isNaN(row), 0) / state.rows.length;
  showStatus(`${before} in ${Math.round(100 * share)} % of the columns`);
}

export function showSkyline(skyline) {
  Object.assign(state, skyline);
  buttons();
  emit("skyline");
}

export function buttons() {
  $("undo").disabled = !state.photo?.strokes?.length && !state.photo?.before;
  $("redo").disabled = !undone.length;
}

export function forget() {
  undone.length = 0;
}

// What a drag over the photo does, step by step and at its end.
const DRAGS = {
  pan: { move: (event, by) => pan(...by), end: () => {} },
  turn: { move: (event, [across, down]) => turnBy(across / view.scale, down / view.scale, true), end: release },
  paint: { move: paint, end: finish },
};

function dragOf(event) {
  if (event.button !== 0) return DRAGS.pan;
  if (marks.brush) return DRAGS.paint;
  return tool() === "turn" ? DRAGS.turn : DRAGS.pan;
}

function dragging(event) {
  if (!event.isPrimary) return;
  canvas.setPointerCapture(event.pointerId);
  dragged = dragOf(event);
  if (dragged === DRAGS.paint) begin(inPhoto(event));
  let last = [event.clientX, event.clientY];
  const move = (next) => {
    if (!next.isPrimary) return;
    const by = [next.clientX - last[0], next.clientY - last[1]];
    last = [next.clientX, next.clientY];
    dragged?.move(next, by);
  };
  const end = () => {
    canvas.removeEventListener("pointermove", move);
    dragged?.end();
    dragged = null;
  };
  canvas.addEventListener("pointermove", move);
  canvas.addEventListener("lostpointercapture", end, { once: true });
}

// A second finger has come down: the first one does not draw, and the photo moves with both.
function pinched() {
  if (dragged === DRAGS.turn) release();
  dragged = null;
  marks.stroke = null;
  draw();
}

// On a phone the tools are shown when they are asked for.
function mend() {
  const isShown = document.querySelector("main").classList.toggle("mending");
  $("mend").setAttribute("aria-expanded", String(isShown));
  choose(isShown ? "sky" : "move");
  if (isShown) toView("photo-pane");
}

function paint(event) {
  const all = event.getCoalescedEvents?.() ?? [];
  marks.stroke.points.push(...(all.length ? all : [event]).map((one) => rounded(inPhoto(one))));
  draw();
}

function step([across, down], isLong) {
  const px = isLong ? 40 : 6;
  if (tool() === "turn") turnBy((across * px) / view.scale, (down * px) / view.scale, false);
  else if (marks.brush) moveCross((across * px) / view.scale, (down * px) / view.scale);
  else pan(-across * px * 5, -down * px * 5);
}

const inMiddle = () => [state.photo.width_px / 2, state.photo.height_px / 2];

function moveCross(columns, rows) {
  const { width_px, height_px } = state.photo;
  const [column, row] = marks.cross || inMiddle();
  marks.cross = [
    Math.min(width_px - 1, Math.max(0, column + columns)),
    Math.min(height_px - 1, Math.max(0, row + rows)),
  ];
  marks.stroke?.points.push(rounded(marks.cross));
  keepInView(marks.cross);
}

// Begins a stroke at the cross, or ends it there.
function strokeAtCross() {
  if (marks.stroke) return finish();
  marks.cross ||= inMiddle();
  begin(marks.cross);
  draw();
}

function resizeBrush(times) {
  $("brush").value = Number($("brush").value) * times;
  chosen();
}

function forgetMarks() {
  marks.stroke = null;
  marks.cross = null;
  draw();
}

const ACTIONS = {
  "+": () => zoom(1.5),
  "=": () => zoom(1.5),
  "-": () => zoom(1 / 1.5),
  0: fit,
  1: () => zoom(1 / view.scale),
  "[": () => resizeBrush(0.8),
  "]": () => resizeBrush(1.25),
  Escape: forgetMarks,
};

// What a key does on the photo, if it does anything.
function actionOf({ key, ctrlKey, metaKey, shiftKey }) {
  const letter = key.toLowerCase();
  if (ctrlKey || metaKey) return letter === "z" ? (shiftKey ? redo : undo) : undefined;
  if (ARROWS[key]) return () => step(ARROWS[key], shiftKey);
  if (KEYS[letter]) return () => choose(KEYS[letter]);
  if (key === "Enter" || key === " ") return marks.brush ? strokeAtCross : undefined;
  return ACTIONS[key];
}

function pressed(event) {
  const act = event.altKey || !state.photo ? undefined : actionOf(event);
  if (!act) return;
  act();
  event.preventDefault();
}

export async function traceFrom(file) {
  const photo = state.photo;
  if (!photo) return alertUser(`${file.name} is a trace; first add the photo that it belongs to`, "trace");
  settle("trace");
  try {
    const trace = await file.text();
    const skyline = await server.startFrom(photo, trace);
    Object.assign(photo, loaded(photo, trace), { solved: 0 });
    keep(photo);
    emit("mended");
    if (photo !== state.photo) return;
    forget();
    showSkyline(skyline);
    showStatus(`${file.name} loaded`);
  } catch (error) {
    report(error, "trace");
  }
}

export function start() {
  for (const input of document.querySelectorAll("input[name=tool]")) input.onchange = chosen;
  $("brush").oninput = chosen;
  canvas.addEventListener("pointerdown", (event) => state.photo && dragging(event));
  canvas.addEventListener("pointermove", () => {
    if (marks.brush) marks.brush = Math.max(radius(), 2 / view.scale);
  });
  canvas.addEventListener("keydown", pressed);
  document.addEventListener("keydown", (event) => {
    // The photo's keys work on the whole page; letters of tools also while a button has the focus.
    const isTool = KEYS[event.key.toLowerCase()] && !event.ctrlKey && !event.metaKey;
    if (event.target === document.body || (isTool && !event.target.matches("#photo, select, input[type=number], input[type=text]"))) pressed(event);
  });
  on("connected", send);
  on("pinch", pinched);
  on("photo", (photo) => ($("mend").disabled = !photo));
  $("mend").onclick = mend;
  $("undo").onclick = undo;
  $("redo").onclick = redo;
  $("load-trace").onclick = () => $("trace-file").click();
  $("trace-file").onchange = async () => {
    for (const file of $("trace-file").files) await traceFrom(file);
    $("trace-file").value = "";
  };
  chosen();
}

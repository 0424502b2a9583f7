// The list of photos, added by dropping or choosing files, each with its state.
import * as server from "./server.js";
import { $, alertUser, element, emit, on, report, setArea, setPhoto, settle, showStatus, state } from "./state.js";
import { buttons, forget, resume, showShare, showSkyline, traceFrom, waits } from "./brush.js";
import { leave } from "./hand.js";
import { forgetDraft, keepDraft, keptFor, workOn } from "./kept.js";
import { show } from "./view.js";

const WORDS = { waiting: "waiting", opening: "opening…", ready: "ready", matching: "searching…",
  answered: "✓ found", "no answer": "? not sure", unusable: "✗ not used", missing: "add it again" };
// States of photos that the server does not have.
const LOST = ["unusable", "missing"];
let loading = false;

function list() {
  $("photos").replaceChildren(...state.photos.map(row));
  const opening = !state.photo && state.photos.some((photo) => photo.state === "opening");
  $("busy").hidden = !loading && !opening;
  $("welcome").hidden = Boolean(state.photo) || opening;
  const { width_px, height_px } = state.photo ?? {};
  const panes = document.querySelector("main");
  panes.classList.toggle("portrait", height_px > width_px);
  if (width_px) panes.style.setProperty("--shape", width_px / height_px);
  const kept = keptFor(state.photos);
  $("kept").textContent = kept.length ? `Unsaved strokes are kept for ${kept.join(", ")}: add the photo again to go on.` : "";
  for (const id of ["tools", "legend"]) $(id).hidden = !state.photo;
  $("find-all").hidden = state.photos.filter((photo) => photo.state === "ready").length < 2;
}

function row(photo) {
  const remove = element("button", { "aria-label": `Remove ${photo.name}`, title: "Remove", onclick: () => drop(photo) }, "×");
  if (LOST.includes(photo.state)) {
    return element("li", {}, element("span", { class: "why", title: photo.error }, element("span", { class: "name" }, photo.name), WORDS[photo.state]), remove);
  }
  const pick = element("button", { class: "pick", "aria-current": String(photo === state.photo), onclick: () => choose(photo) },
    element("span", { class: "name", title: photo.name }, photo.name),
    element("span", { class: "state" }, WORDS[photo.state]));
  return element("li", {}, pick, ...(photo.state === "opening" ? [] : [remove]));
}

// Shows what another tab has added, removed, mended or found.
async function follow() {
  const before = state.photos.filter((one) => one.id && server.isOpen(one));
  const records = await server.records().catch(() => null);
  if (!records) return;
  const ids = records.map((one) => one.id);
  for (const photo of before) if (!ids.includes(photo.id)) leaveOut(photo);
  for (const record of records) {
    const photo = state.photos.find((one) => one.id === record.id || isGivenAs(one, record));
    if (!photo) state.photos.push(takenOver({}, record));
    else if (!waits(photo) && isOther(photo, record) && takenOver(photo, record) === state.photo) await choose(photo);
  }
  list();
  if (!state.photo && state.photos.length) await choose(state.photos[0]);
}

// Whether this is a photo that the command names and this page has not opened yet.
const isGivenAs = (photo, record) => !photo.id && photo.given !== undefined && photo.name === record.name;

const isOther = (photo, record) => ["strokes", "trace", "result", "projection"].some(
  (name) => JSON.stringify(photo[name] ?? null) !== JSON.stringify(record[name] ?? null));

function takenOver(photo, record) {
  // A search of another tab has its own request and poses.
  if (JSON.stringify(photo.result ?? null) !== JSON.stringify(record.result ?? null)) forgetDraft(record);
  const work = { session: server.current(), solved: record.strokes.length, unsaved: Boolean(workOn(record)) };
  return Object.assign(photo, record, work);
}

export async function choose(photo) {
  if (["waiting", "opening", ...LOST].includes(photo.state)) return;
  if (!photo.id && !(await open(photo, () => server.openGiven(photo.given)).catch(() => false))) return;
  setPhoto(photo);
  emit("photo", null); // What is shown of the last photo is not of this one.
  showStatus("");
  setArea(photo.area);
  forget();
  loading = true;
  show(null);
  list();
  try {
    const [blob, skyline] = await Promise.all([server.picture(photo), server.skyline(photo, null)]);
    const bitmap = await createImageBitmap(blob);
    if (photo !== state.photo) return;
    show(bitmap);
    showSkyline(skyline);
    showShare(`${photo.name}: skyline`);
  } catch (error) {
    report(error, "photo");
    if (photo !== state.photo) return;
  }
  loading = false;
  list();
  buttons();
  emit("photo", photo);
}

// Opens a photo, resumes the work on it, and returns whether it is open. The work is from this page,
// before a restart of the server, or was kept by the browser. Without an answer from the server the
// photo stays as it was, and the error is thrown.
async function open(photo, opened, failed = "unusable") {
  const { state: before, content, strokes, trace, projection } = photo;
  photo.state = "opening";
  list();
  try {
    const record = await opened();
    if (content && record.content !== content) {
      await server.remove(record);
      throw new Error(`${photo.name} has changed; add the photo as it was, or remove it`);
    }
    Object.assign(photo, record, { solved: 0, unsaved: photo.unsaved || Boolean(workOn(record)) });
    if (projection && projection !== photo.projection) {
      await server.project(photo, projection);
      photo.projection = projection;
    }
    const work = content ? { strokes, trace } : workOn(photo);
    if (work) await resume(photo, work);
  } catch (error) {
    const waits = error.kind === "server";
    Object.assign(photo, { state: waits ? before : failed, error: error.message });
    showStatus("");
    report(error, "photo");
    if (waits) throw error;
  }
  list();
  return !LOST.includes(photo.state);
}

// Opens all photos again, after the server was started again. It has no searches then.
export async function restore() {
  const about = await server.about();
  if (JSON.stringify(about) !== JSON.stringify(state.server)) {
    alertUser("The server was started again with another store or other photos: reload the page.", "store");
  }
  const there = await server.records();
  for (const photo of state.photos.filter((one) => one.content && one.state !== "missing" && !server.isOpen(one))) {
    const isFound = Boolean(photo.result);
    // Another tab may have opened it again already.
    const again = there.find((one) => one.content === photo.content);
    const opened = () => (again ? { ...again, session: server.current() } : sendAgain(photo));
    if (!(await open(photo, opened, "missing")) || photo !== state.photo) continue;
    leave();
    showSkyline(await server.skyline(photo, null));
    if (isFound) showStatus("The server was started again: find the place again");
  }
}

async function sendAgain(photo) {
  if (photo.file) return server.upload(photo.file);
  if (photo.given !== undefined) return server.openGiven(photo.given);
  throw new Error(`The server was started again without ${photo.name}: add the photo again to go on.`);
}

export async function add(chosen) {
  const all = [...chosen];
  const traces = all.filter((file) => /\.csv$/i.test(file.name));
  const files = all.filter((file) => !traces.includes(file));
  state.photos.push(...files.map((file) => ({ name: file.name, file, state: "waiting" })));
  settle("photo");
  await openWaiting();
  for (const trace of traces) await traceFrom(trace);
}

// Opens added photos, and shows the first of them; without a server they wait.
async function openWaiting() {
  let first = true;
  list();
  for (const photo of [...state.photos]) {
    if (photo.state !== "waiting" || !state.photos.includes(photo)) continue;
    if (!(await open(photo, () => server.upload(photo.file)).catch(() => false))) continue;
    state.photos = state.photos.filter((one) => one.state !== "missing" || one.content !== photo.content);
    const same = state.photos.find((one) => one !== photo && one.content === photo.content && server.isOpen(one));
    if (same) {
      // The browser keeps the strokes of both as one.
      await server.remove(photo).catch((error) => report(error, "photo"));
      leaveOut(photo);
    }
    server.tellOthers();
    if (first) await choose(same ?? photo);
    if (first && same) showStatus(`${photo.name} is open already`);
    first = false;
  }
}

async function drop(photo) {
  if (photo.id && !LOST.includes(photo.state)) await server.remove(photo).catch((error) => report(error, "photo"));
  settle("photo");
  forgetDraft(photo);
  leaveOut(photo);
  server.tellOthers();
  list();
}

function leaveOut(photo) {
  state.photos = state.photos.filter((one) => one !== photo);
  if (photo === state.photo) {
    setPhoto(null);
    setArea(state.server.area);
    loading = false;
    show(null);
    showStatus("");
    emit("photo", null);
  }
}

function dropping() {
  let depth = 0;
  addEventListener("dragenter", (event) => {
    if (![...event.dataTransfer.types].includes("Files")) return;
    depth++;
    $("drop").hidden = false;
  });
  addEventListener("dragleave", () => {
    depth = Math.max(0, depth - 1);
    $("drop").hidden = depth === 0;
  });
  addEventListener("dragover", (event) => event.preventDefault());
  addEventListener("drop", (event) => {
    event.preventDefault();
    depth = 0;
    $("drop").hidden = true;
    add(event.dataTransfer.files);
  });
}

// Takes up a photo that the server has; the index is not negative if the command names the photo.
async function takeUp(photo, given) {
  const work = workOn(photo);
  Object.assign(photo, { session: server.current(), solved: photo.strokes.length, unsaved: Boolean(work) });
  if (given >= 0) photo.given = given;
  // An answer is shown with the request that it is to.
  if (photo.result) keepDraft(photo, { known: null });
  // Strokes that were drawn while the server did not answer.
  if (work && work.strokes.length !== photo.strokes.length) await resume(photo, work).catch((error) => report(error, "strokes"));
}

export async function start(opened) {
  for (const [files, buttons] of Object.entries({ files: ["choose", "add"], taken: ["take", "take-more"] })) {
    for (const id of buttons) $(id).onclick = () => $(files).click();
    $(files).onchange = () => {
      add($(files).files);
      $(files).value = "";
    };
  }
  dropping();
  on("states", list);
  on("elsewhere", follow);
  on("projected", choose);
  for (const name of ["result", "mended", "projected"]) on(name, server.tellOthers);
  on("connected", async () => {
    if (state.photo && !state.rows) await choose(state.photo);
    await openWaiting();
  });
  const { given } = state.server;
  for (const photo of opened) await takeUp(photo, given.indexOf(photo.name));
  const others = given.map((name, index) => ({ name, given: index, state: "ready" }));
  const names = opened.map((photo) => photo.name);
  state.photos = [...opened, ...others.filter((photo) => !names.includes(photo.name))];
  list();
  if (state.photos.length) await choose(state.photos[0]);
}

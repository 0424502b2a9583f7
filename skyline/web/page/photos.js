// The list of photos, added by dropping or choosing files, each with its state.
import * as server from "./server.js";
import { $, alertUser, element, on, showStatus, state, emit } from "./state.js";
import { buttons, forget, showSkyline, traceFrom } from "./brush.js";
import { show } from "./view.js";

const WORDS = { waiting: "waiting", opening: "opening…", ready: "ready", matching: "searching…",
  answered: "✓ found", "no answer": "? not sure" };
let loading = false;

function list() {
  $("photos").replaceChildren(...state.photos.map((photo) => {
    const remove = element("button", { "aria-label": `Remove ${photo.name}`, title: "Remove", onclick: () => drop(photo) }, "×");
    if (photo.state === "unusable") {
      return element("li", {}, element("span", { class: "why", title: photo.error }, element("span", { class: "name" }, photo.name), "✗ not used"), remove);
    }
    const pick = element("button", { class: "pick", "aria-current": String(photo === state.photo), onclick: () => choose(photo) },
      element("span", { class: "name", title: photo.name }, photo.name),
      element("span", { class: "state" }, WORDS[photo.state]));
    return element("li", {}, pick, ...(photo.state === "opening" ? [] : [remove]));
  }));
  const opening = !state.photo && state.photos.some((photo) => photo.state === "opening");
  $("busy").hidden = !loading && !opening;
  $("welcome").hidden = Boolean(state.photo) || opening;
  for (const id of ["tools", "legend"]) $(id).hidden = !state.photo;
  $("find-all").hidden = state.photos.filter((photo) => photo.state === "ready").length < 2;
}

export async function choose(photo) {
  if (photo.state === "opening" || photo.state === "unusable") return;
  if (photo.given !== undefined && !photo.id) {
    await open(photo, () => server.openGiven(photo.given));
    if (!photo.id) return;
  }
  state.photo = photo;
  state.rows = state.sight = state.pose = state.chosen = state.origin = state.fit = null;
  forget();
  loading = true;
  show(null);
  list();
  try {
    const [blob, lines] = await Promise.all([server.picture(photo), server.skyline(photo, null)]);
    const bitmap = await createImageBitmap(blob);
    if (photo !== state.photo) return;
    show(bitmap);
    showSkyline(lines);
    showStatus(`${photo.name}: skyline in ${Math.round(100 * photo.trusted)} % of the columns`);
  } catch (error) {
    alertUser(error.message);
    if (photo !== state.photo) return;
  }
  loading = false;
  list();
  buttons();
  emit("photo", photo);
}

async function open(photo, opened) {
  photo.state = "opening";
  list();
  try {
    Object.assign(photo, await opened());
  } catch (error) {
    photo.state = "unusable";
    photo.error = error.message;
    showStatus("");
    alertUser(error.message);
  }
  list();
}

export async function add(chosen) {
  const all = [...chosen];
  const traces = all.filter((file) => /\.csv$/i.test(file.name));
  const files = all.filter((file) => !traces.includes(file));
  const records = files.map(({ name }) => ({ name, state: "waiting" }));
  state.photos.push(...records);
  list();
  let first = true;
  for (const [index, record] of records.entries()) {
    if (!state.photos.includes(record)) continue;
    await open(record, () => server.upload(files[index]));
    if (first && record.state === "ready") {
      first = false;
      await choose(record);
    }
  }
  for (const trace of traces) await traceFrom(trace);
}

async function drop(photo) {
  if (photo.id) await server.remove(photo).catch((error) => alertUser(error.message));
  state.photos = state.photos.filter((one) => one !== photo);
  if (photo === state.photo) {
    state.photo = state.rows = state.sight = state.pose = state.origin = state.fit = null;
    loading = false;
    show(null);
    showStatus("");
    emit("photo", null);
  }
  list();
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

export async function start(kept) {
  for (const id of ["choose", "add"]) $(id).onclick = () => $("files").click();
  $("files").onchange = () => {
    add($("files").files);
    $("files").value = "";
  };
  dropping();
  on("states", list);
  const given = state.store.given.map((name, index) => ({ name, given: index, state: "ready" }));
  const opened = new Set(kept.map((photo) => photo.name));
  state.photos = [...kept, ...given.filter((photo) => !opened.has(photo.name))];
  list();
  if (state.photos.length) await choose(state.photos[0]);
}

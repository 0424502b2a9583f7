// The pose: set by a candidate or by hand. The skyline rendered at it follows while it moves.
import * as server from "./server.js";
import { $, alertUser, element, on, say, state, tell, widest } from "./state.js";
import { middle } from "./map.js";

const SLIDERS = [
  ["heading", "Heading °", 0, 360, 0.1],
  ["pitch", "Pitch °", -30, 30, 0.05],
  ["roll", "Roll °", -20, 20, 0.05],
  ["fov", "Field of view °", 10, 120, 0.1],
  ["eyeHeight", "Eye height m", 0, 300, 0.5],
];
const PLACES = [["lat", "Latitude, degrees", -90, 90], ["lon", "Longitude, degrees", -180, 180]];
export const live = { shown: 0, latency: [] };
let flying = null, next = null, number = 0;

export function moveTo(part, stillMoving = false) {
  if (!state.pose) return;
  // A candidate may look from below the summit beside it; elsewhere that is below the ground.
  if ("lon" in part || "lat" in part) state.pose.eyeHeight = Math.max(0, state.pose.eyeHeight);
  Object.assign(state.pose, part);
  state.byHand = true;
  changed(stillMoving);
}

export function setPose(pose) {
  state.pose = pose && { ...pose };
  state.byHand = false;
  state.sight = null;
  changed(false);
}

export const release = () => changed(false);

// Drags the rendered skyline over the photo, in photo pixels.
export function turnBy(columns, rows, stillMoving) {
  if (!state.pose || !state.photo) return;
  const perPixel = state.pose.fov / state.photo.width;
  moveTo({ heading: (state.pose.heading - columns * perPixel + 360) % 360,
    pitch: Math.max(-30, Math.min(30, state.pose.pitch + rows * perPixel)) }, stillMoving);
}

function changed(stillMoving) {
  $("hand-form").hidden = !state.pose;
  $("hand-hint").hidden = Boolean(state.pose);
  $("fit").disabled = !state.pose;
  if (state.pose) {
    fill();
    look(!stillMoving);
  } else $("gap").hidden = true;
  tell("pose");
}

function fill() {
  $("hand-fov").max = $("hand-fov-number").max = widest(state.photo);
  for (const [name, , , , step] of SLIDERS) {
    for (const id of [`hand-${name}`, `hand-${name}-number`]) {
      if (document.activeElement !== $(id) || !state.typing) $(id).value = round(state.pose[name], step);
    }
  }
  for (const [name] of PLACES) if (!state.typing) $(`hand-${name}`).value = state.pose[name].toFixed(5);
}

const round = (value, step) => (Math.round(value / step) * step).toFixed(step < 0.1 ? 2 : 1);

// One question is on its way at a time, and only the latest waits.
function look(summits) {
  next = { type: "look", photo: state.photo?.id, pose: { ...state.pose }, summits, asked: performance.now() };
  if (!flying) ask();
}

function ask() {
  if (!next || !next.photo) return;
  flying = { ...next, seq: ++number };
  next = null;
  const { asked, ...told } = flying;
  if (!server.send(told)) flying = null;
}

function answered(told) {
  if (!flying || told.seq !== flying.seq) return;
  const { photo, asked } = flying;
  flying = null;
  ask();
  if (photo !== state.photo?.id || !state.pose) return;
  if (told.error) {
    state.sight = null;
    $("gap").textContent = told.error;
  } else {
    if (!told.summits && state.sight?.summits) told.summits = null;
    state.sight = told;
    $("gap").textContent = told.gap === null ? "nothing to compare" : `skylines ${told.gap.toFixed(2)}° apart`;
    live.shown++;
    live.latency.push(performance.now() - asked);
    if (live.latency.length > 1000) live.latency.shift();
  }
  $("gap").hidden = false;
  tell("sight");
}

async function fit() {
  const button = $("fit");
  button.disabled = true;
  say("Fitting…");
  const photo = state.photo;
  try {
    const found = await server.fit(photo, state.pose);
    if (photo !== state.photo) return;
    moveTo({ lon: found.lon, lat: found.lat, heading: found.heading, pitch: found.pitch, roll: found.roll, fov: found.fov, distortion: found.distortion, eyeHeight: found.eyeHeight ?? state.pose.eyeHeight });
    say("Fitted");
  } catch (error) {
    say("");
    alertUser(error.message);
  }
  button.disabled = !state.pose;
}

export function placeAt(place) {
  if (!state.photo) return alertUser("add a photo first");
  const fov = $("fov-known").checked ? Number($("fov").value) : state.photo.fov ?? 60;
  const heading = state.photo.heading ?? ($("heading-known").checked ? Number($("heading").value) : 0);
  setPose({ lon: place.lng, lat: place.lat, heading, pitch: 0, roll: 0, fov, eyeHeight: Number($("eye").value) || 2 });
  state.byHand = true;
  tell("chosen");
}

function makeForm() {
  const rows = SLIDERS.map(([name, label, min, max, step]) => {
    const range = element("input", { id: `hand-${name}`, type: "range", min, max, step, "aria-label": label });
    const value = element("input", { id: `hand-${name}-number`, type: "number", step, "aria-label": `${label}, typed` });
    const move = (input, stillMoving) => () => {
      state.typing = input === value;
      if (input.value !== "" && Number.isFinite(input.valueAsNumber)) moveTo({ [name]: input.valueAsNumber }, stillMoving);
      state.typing = false;
    };
    range.oninput = move(range, true);
    range.onchange = move(range, false);
    value.onchange = move(value, false);
    return element("div", { class: "row" }, element("label", { for: `hand-${name}` }, label), range, value);
  });
  const places = PLACES.map(([name, label, min, max]) => {
    const value = element("input", { id: `hand-${name}`, type: "number", min, max, step: "any", "aria-label": label, class: "place" });
    value.onchange = () => Number.isFinite(value.valueAsNumber) && moveTo({ [name]: value.valueAsNumber });
    return value;
  });
  const where = element("label", { for: "hand-lat" }, "Lat., long. °");
  $("hand-form").append(...rows, element("div", { class: "row" }, where, ...places));
  $("hand-form").onsubmit = (event) => event.preventDefault();
}

export function start() {
  makeForm();
  $("fit").onclick = fit;
  $("place-here").onclick = () => placeAt(middle());
  on("look", answered);
  on("connected", () => {
    flying = null;
    if (state.pose) look(true);
  });
  on("skyline", () => state.pose && look(true));
  on("photo", () => setPose(null));
}

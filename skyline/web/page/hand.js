// The pose, set by a candidate or by hand. The rendered skyline follows while it moves.
import * as server from "./server.js";
import { $, alertUser, element, emit, on, report, settle, showStatus, state, widest } from "./state.js";
import { known, standing } from "./known.js";

const USUAL_EYE_M = 2;

const SLIDERS = [
  ["heading", "Heading °", 0, 360, 0.1],
  ["pitch", "Pitch °", -30, 30, 0.05],
  ["roll", "Roll °", -20, 20, 0.05],
  ["fov", "Field of view °", 10, 120, 0.1],
  ["eyeHeight", "Eye height m", 0, 300, 0.5],
];
const PLACES = [["lat", "Latitude, degrees", -90, 90], ["lon", "Longitude, degrees", -180, 180]];
let flying = null, next = null, number = 0;

export function moveTo(part, stillMoving = false) {
  if (!state.pose) return;
  // Beside a summit a candidate's eye height may be negative; at another place it must not be.
  if ("lon" in part || "lat" in part) state.pose.eyeHeight = Math.max(0, state.pose.eyeHeight);
  Object.assign(state.pose, part);
  leave();
  changed(stillMoving);
}

// From now on the pose is set by hand, and the verdict of a search or a fit no longer holds.
export function leave() {
  if (!state.pose || state.origin === "hand") return;
  Object.assign(state, { origin: "hand", chosen: null, fit: null });
  showStatus("");
  $("pose-verdict").replaceChildren(...verdict());
  emit("left");
}

function setPose(pose, origin, { chosen = null, fit = null } = {}) {
  Object.assign(state, { pose, origin, chosen, fit, sight: fit && state.sight });
  changed(false);
}

const placed = ({ lon, lat, heading, pitch, roll, fov, distortion, wander, eyeHeight }) =>
  ({ lon, lat, heading, pitch, roll, fov, distortion, wander, eyeHeight: eyeHeight ?? known().eyeHeight ?? USUAL_EYE_M });

export const toCandidate = (one, chosen) => setPose(placed(one), "found", { chosen });

export const release = () => changed(false);

// Drags the rendered skyline over the photo, in photo pixels.
export function turnBy(columns, rows, stillMoving) {
  if (!state.pose || !state.photo) return;
  const perPixel = state.pose.fov / state.photo.width;
  moveTo({ heading: (state.pose.heading - columns * perPixel + 360) % 360,
    pitch: Math.max(-30, Math.min(30, state.pose.pitch + rows * perPixel)) }, stillMoving);
}

function changed(stillMoving) {
  settle("fit");
  $("hand-form").hidden = !state.pose;
  $("hand-hint").hidden = Boolean(state.pose);
  $("pose-verdict").replaceChildren(...verdict());
  $("fit").disabled = !state.pose;
  if (state.pose) {
    fill();
    look(!stillMoving);
  } else $("gap").hidden = true;
  emit("pose");
}

function verdict() {
  if (state.origin === "hand") return ["The camera is set by hand: no search has judged this pose."];
  if (!state.fit) return [];
  const { refusal, candidates: [{ residual }] } = state.fit;
  if (state.chosen !== null) {
    return standing() ? [element("span", { class: "yes" }, `Fitted to candidate ${state.chosen + 1}: `), `${residual}.`] : [];
  }
  if (!refusal) return [element("span", { class: "yes" }, "Fitted: "), `${residual}. No search has judged this pose.`];
  return [element("span", { class: "no" }, "The fit has failed: "), `${refusal}. Bring the two skylines closer by hand.`];
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

// One request is under way at a time, and only the latest waits.
function look(summits) {
  next = { type: "look", photo: state.photo?.id, pose: { ...state.pose }, summits, asked: performance.now() };
  if (!flying) ask();
}

function ask() {
  if (!next || !next.photo) return;
  flying = { ...next, seq: ++number };
  next = null;
  const { asked, ...request } = flying;
  if (!server.send(request)) flying = null;
}

function answered(seen) {
  if (!flying || seen.seq !== flying.seq) return;
  const { photo, asked } = flying;
  flying = null;
  ask();
  if (photo !== state.photo?.id || !state.pose) return;
  if (seen.error) {
    state.sight = null;
    $("gap").textContent = seen.error;
  } else {
    if (!seen.summits && state.sight?.summits) seen.summits = null;
    state.sight = seen;
    $("gap").textContent = seen.gap === null ? "nothing to compare" : `skylines ${seen.gap.toFixed(2)}° apart in the median column`;
    if (seen.seq % 1000 === 0) performance.clearMeasures("look");  // They would fill the memory.
    performance.measure("look", { start: asked });
  }
  $("gap").hidden = false;
  emit("sight");
}

async function fit() {
  const button = $("fit");
  button.disabled = true;
  settle("fit");
  showStatus("Fitting…");
  const photo = state.photo;
  try {
    const found = await server.fit(photo, state.pose, known());
    if (photo !== state.photo) return;
    const [pose] = found.candidates, chosen = pose.rank === null ? null : pose.rank - 1;
    setPose(placed(pose), "fitted", { chosen, fit: found });
    emit("left");
    showStatus(found.refusal && chosen === null ? "The fit has failed" : "Fitted");
  } catch (error) {
    showStatus("");
    report(error, "fit");
  }
  button.disabled = !state.pose;
}

export function placeAt({ lon, lat }) {
  if (!state.photo) return alertUser("Add a photo first.", "fit");
  const asked = known(), fov = asked.fov ?? state.photo.fov ?? 60;
  const heading = asked.heading?.[0] ?? state.photo.heading ?? 0;
  setPose({ lon, lat, heading, pitch: 0, roll: 0, fov, eyeHeight: asked.eyeHeight ?? USUAL_EYE_M }, "hand");
  emit("chosen");
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
  on("look", answered);
  on("connected", () => {
    flying = null;
    if (state.pose) look(true);
  });
  on("skyline", () => {
    // The last fit was to another skyline.
    if (state.origin === "fitted") leave();
    if (state.pose) changed(false);
  });
  on("known", () => $("pose-verdict").replaceChildren(...verdict()));
  on("photo", () => setPose(null, null));
}

// The pose, set by a candidate or by hand. The rendered skyline follows while it moves.
import * as server from "./server.js";
import { $, alertUser, element, emit, on, report, settle, showStatus, state, widest } from "./state.js";
import { draftOf, keepDraft } from "./kept.js";
import { known, standing } from "./known.js";

const USUAL_EYE_HEIGHT_M = 2;
const USUAL_FOV_DEG = 60;
const MOST_PITCH_DEG = 30;

const SLIDERS = [
  { name: "heading_deg", label: "Heading °", min: 0, max: 360, step: 0.1 },
  { name: "pitch_deg", label: "Pitch °", min: -MOST_PITCH_DEG, max: MOST_PITCH_DEG, step: 0.05 },
  { name: "roll_deg", label: "Roll °", min: -20, max: 20, step: 0.05 },
  { name: "fov_deg", label: "Field of view °", min: 10, max: 120, step: 0.1 },
  { name: "eye_height_m", label: "Eye height m", min: 0, max: 300, step: 0.5 },
];
const POSITION = [
  { name: "lat", label: "Latitude, degrees", min: -90, max: 90 },
  { name: "lon", label: "Longitude, degrees", min: -180, max: 180 },
];
let flying = null; // the request for a skyline that the server is answering
let next = null; // the request that goes after it
let count = 0; // number of requests

export function moveTo(part, stillMoving = false) {
  if (!state.pose) return;
  // Beside a summit a candidate's eye height may be negative; at another place it must not be.
  if ("lon" in part || "lat" in part) state.pose.eye_height_m = Math.max(0, state.pose.eye_height_m);
  Object.assign(state.pose, part);
  leave();
  changed(stillMoving);
}

// From now on the pose is set by hand, and the verdict of a search or a fit no longer holds.
export function leave() {
  if (!state.pose || state.origin === "hand") return;
  Object.assign(state, { origin: "hand", chosen: null, fit: null });
  showStatus("");
  showVerdict();
  emit("left");
}

function setPose(pose, origin, { chosen = null, fit = null } = {}) {
  Object.assign(state, { pose, origin, chosen, fit, sight: fit && state.sight });
  changed(false);
}

// The pose of a candidate, with the eye's height in place of its elevation: the height stays when
// the camera is moved.
function placed({ pose, eye_height_m }) {
  const { lon, lat, heading_deg, pitch_deg, roll_deg, fov_deg, distortion, wander } = pose;
  return { lon, lat, heading_deg, pitch_deg, roll_deg, fov_deg, distortion, wander,
    eye_height_m: eye_height_m ?? eyeHeight() };
}

const eyeHeight = () => known().eye_height_m ?? USUAL_EYE_HEIGHT_M;

export const toCandidate = (candidate, chosen) => setPose(placed(candidate), "found", { chosen });

// Returns to the pose that a photo was left with, if that is no candidate's.
export function toLeft(photo) {
  const { pose } = draftOf(photo);
  if (pose) setPose(pose, "hand");
  return Boolean(pose);
}

export const release = () => changed(false);

// Drags the rendered skyline over the photo, in photo pixels.
export function turnBy(columns, rows, stillMoving) {
  if (!state.pose || !state.photo) return;
  const { heading_deg, pitch_deg, fov_deg } = state.pose;
  const perPixel = fov_deg / state.photo.width_px;
  const raised = pitch_deg + rows * perPixel;
  moveTo({
    heading_deg: (heading_deg - columns * perPixel + 360) % 360,
    pitch_deg: Math.max(-MOST_PITCH_DEG, Math.min(MOST_PITCH_DEG, raised)),
  }, stillMoving);
}

function changed(stillMoving) {
  settle("fit");
  if (state.photo && state.pose && !stillMoving) keepDraft(state.photo, { pose: state.chosen === null ? state.pose : null });
  $("hand-form").hidden = !state.pose;
  $("hand-hint").hidden = Boolean(state.pose);
  $("fit").disabled = !state.pose;
  showVerdict();
  if (state.pose) {
    fill();
    look(!stillMoving);
  } else $("gap").hidden = true;
  emit("pose");
}

const showVerdict = () => $("pose-verdict").replaceChildren(...verdict());

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
  for (const id of ["hand-fov_deg", "hand-fov_deg-number"]) $(id).max = widest(state.photo);
  for (const { name, step } of SLIDERS) {
    for (const id of [`hand-${name}`, `hand-${name}-number`]) {
      if (document.activeElement !== $(id) || !state.typing) $(id).value = round(state.pose[name], step);
    }
  }
  for (const { name } of POSITION) if (!state.typing) $(`hand-${name}`).value = state.pose[name].toFixed(5);
}

const round = (value, step) => (Math.round(value / step) * step).toFixed(step < 0.1 ? 2 : 1);

// One request is under way at a time, and only the latest waits.
function look(summits) {
  next = { type: "look", photo: state.photo?.id, pose: { ...state.pose }, summits, began: performance.now() };
  if (!flying) ask();
}

function ask() {
  if (!next || !next.photo) return;
  flying = { ...next, seq: ++count };
  next = null;
  const { began, ...request } = flying;
  if (!server.send(request)) flying = null;
}

function answered(answer) {
  if (!flying || answer.seq !== flying.seq) return;
  const { photo, began } = flying;
  flying = null;
  ask();
  if (photo !== state.photo?.id || !state.pose) return;
  state.sight = answer.error ? null : answer;
  $("gap").textContent = answer.error ?? gapInWords(answer.median_gap_deg);
  $("gap").hidden = false;
  if (!answer.error) measure(answer.seq, began);
  emit("sight");
}

const gapInWords = (gap_deg) =>
  gap_deg === null ? "nothing to compare" : `skylines ${gap_deg.toFixed(2)}° apart in the median column`;

function measure(seq, began) {
  if (seq % 1000 === 0) performance.clearMeasures("look");  // They would fill the memory.
  performance.measure("look", { start: began });
}

async function fit() {
  const { photo } = state;
  $("fit").disabled = true;
  settle("fit");
  showStatus("Fitting…");
  try {
    const found = await server.fit(photo, state.pose, known());
    if (photo !== state.photo) return;
    showFit(found);
  } catch (error) {
    showStatus("");
    report(error, "fit");
  }
  $("fit").disabled = !state.pose;
}

function showFit(found) {
  const [candidate] = found.candidates;
  const chosen = candidate.rank === null ? null : candidate.rank - 1;
  setPose(placed(candidate), "fitted", { chosen, fit: found });
  emit("left");
  showStatus(found.refusal && chosen === null ? "The fit has failed" : "Fitted");
}

export function placeAt({ lon, lat }) {
  const { photo } = state;
  if (!photo) return alertUser("Add a photo first.", "fit");
  const asked = known();
  setPose({
    lon,
    lat,
    heading_deg: asked.heading_deg?.[0] ?? photo.heading_deg ?? 0,
    pitch_deg: 0,
    roll_deg: 0,
    fov_deg: asked.fov_deg ?? photo.fov_deg ?? USUAL_FOV_DEG,
    eye_height_m: eyeHeight(),
  }, "hand");
  emit("chosen");
}

function makeForm() {
  const label = element("label", { for: "hand-lat" }, "Lat., long. °");
  const position = element("div", { class: "row" }, label, ...POSITION.map(positionInput));
  $("hand-form").append(...SLIDERS.map(sliderRow), position);
  $("hand-form").onsubmit = (event) => event.preventDefault();
}

function sliderRow({ name, label, min, max, step }) {
  const id = `hand-${name}`;
  const range = element("input", { id, type: "range", min, max, step, "aria-label": label });
  const typed = element("input", { id: `${id}-number`, type: "number", step, "aria-label": `${label}, typed` });
  const move = (input, stillMoving) => () => {
    state.typing = input === typed;
    if (Number.isFinite(input.valueAsNumber)) moveTo({ [name]: input.valueAsNumber }, stillMoving);
    state.typing = false;
  };
  range.oninput = move(range, true);
  range.onchange = move(range, false);
  typed.onchange = move(typed, false);
  return element("div", { class: "row" }, element("label", { for: id }, label), range, typed);
}

function positionInput({ name, label, min, max }) {
  const typed = element("input", { id: `hand-${name}`, type: "number", min, max, step: "any", "aria-label": label, class: "place" });
  typed.onchange = () => Number.isFinite(typed.valueAsNumber) && moveTo({ [name]: typed.valueAsNumber });
  return typed;
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
  on("known", showVerdict);
  on("photo", () => setPose(null, null));
}

// The search: begun, followed, cancelled; its candidates listed and chosen.
import * as server from "./server.js";
import { $, alertUser, degrees, element, on, say, state, tell } from "./state.js";
import { checked, known } from "./known.js";
import { setPose } from "./hand.js";
import { choose as choosePhoto } from "./photos.js";

const STEPS = { waiting: "waiting for another search", screening: "comparing all places", fitting: "fitting the best", refining: "rendering around the best", done: "done" };

async function find(photo) {
  photo.state = "matching";
  tell("states");
  show();
  try {
    const result = await server.match(photo, known());
    state.results.set(photo.id, result);
    photo.state = result.answered ? "answered" : "no answer";
    if (photo === state.photo) {
      say(`Searched in ${result.seconds.toFixed(1)} s`);
      tell("result");
      show();
      if (result.candidates.length) choose(0);
    }
  } catch (error) {
    photo.state = "ready";
    if (error.message === "cancelled") say("Cancelled");
    else alertUser(error.message);
  }
  tell("states");
  show();
}

async function findAll() {
  for (const photo of state.photos.filter((one) => one.state === "ready")) {
    await choosePhoto(photo);
    if (photo === state.photo && photo.state === "ready") await find(photo);
  }
}

export function choose(index) {
  const one = state.results.get(state.photo?.id)?.candidates[index];
  if (!one) return;
  state.chosen = index;
  setPose({ lon: one.lon, lat: one.lat, heading: one.heading, pitch: one.pitch, roll: one.roll, fov: one.fov,
    distortion: one.distortion, eyeHeight: one.eyeHeight ?? $("eye").valueAsNumber });
  tell("chosen");
  show();
}

function show() {
  const photo = state.photo, result = state.results.get(photo?.id);
  const busy = photo?.state === "matching";
  $("find").disabled = !photo || busy;
  $("progress").hidden = !busy;
  $("answer").replaceChildren(...(photo && result && !busy ? said(result) : []));
  const focused = document.activeElement?.dataset?.rank;
  $("candidates").replaceChildren(...(result && !busy ? result.candidates.map(row) : []));
  if (focused !== undefined) $("candidates").querySelector(`[data-rank="${focused}"]`)?.focus();
}

function said(result) {
  const notes = [result.claim, result.beyond].filter((one) => one)
    .map((one) => element("p", { class: "claim" }, one));
  if (result.answered) {
    const best = result.candidates[0];
    const near = result.within === null ? "" : ` within ${result.within} m`;
    const sure = result.chance === null ? "" : `, ${Math.round(100 * result.chance)} % sure`;
    return [element("span", { class: "yes" }, `Found${near}${sure}. `), degrees(best.lon, best.lat), ...notes];
  }
  return [element("span", { class: "no" }, "No answer: "), `${result.refusal}. `,
    "Check the yellow skyline and mend it, say what you know, or fit by hand.", ...notes];
}

function row(one, index) {
  const sure = one.confidence === null ? "" : `${Math.round(100 * one.confidence)} %`;
  return element("li", {}, element("button", { "aria-current": String(index === state.chosen && !state.byHand), "data-rank": index, onclick: () => choose(index) },
    element("span", {}, String(index + 1)), element("span", {}, sure),
    element("span", {}, degrees(one.lon, one.lat, 4)), element("span", { class: "way", title: "Direction" }, `${one.heading.toFixed(0)}°`)));
}

function progressed(told) {
  const photo = state.photos.find((one) => one.id === told.photo);
  if (!photo || photo !== state.photo || told.done) return;
  $("bar").value = told.share;
  $("step").textContent = STEPS[told.step] ?? told.step;
}

export function start() {
  $("find").onclick = () => {
    if (checked()) {
      $("bar").value = 0;
      $("step").textContent = "";
      find(state.photo);
    }
  };
  $("find-all").onclick = findAll;
  $("cancel").onclick = () => server.cancel(state.photo).catch((error) => alertUser(error.message));
  on("progress", progressed);
  on("choose", choose);
  on("pose", show);
  on("photo", (photo) => {
    show();
    if (photo && state.results.has(photo.id)) choose(0);
  });
}

// The search: start, progress and cancellation, and the list of its candidates.
import * as server from "./server.js";
import { $, degrees, element, emit, mapLink, on, percent, report, setArea, settle, showStatus, state, toView } from "./state.js";
import { known, standing } from "./known.js";
import { leave, toCandidate, toLeft } from "./hand.js";
import { keepDraft } from "./kept.js";
import { choose as choosePhoto } from "./photos.js";

const STEPS = { waiting: "waiting for another search", screening: "comparing all places", fitting: "fitting the best", refining: "rendering the best", "searching around the best": "searching around the best", done: "done",
  "fetching tiles": "fetching elevation", "building the store": "rendering the area's skylines" };

const CANCELLED = "cancelled";
const IDLE = ["ready", "answered", "no answer"];
const awaited = new Set(); // photos whose searches this page has begun

// Returns false if the search was cancelled.
async function find(photo) {
  photo.state = "matching";
  settle("search");
  awaited.add(photo);
  emit("states");
  show();
  let message = null;
  try {
    photo.result = await server.match(photo, known());
    ended(photo, outcome(photo.result));
  } catch (error) {
    ({ message } = error);
    if (message === CANCELLED) showStatus("Cancelled");
    else report(error, "search");
    photo.state = "ready";
  }
  awaited.delete(photo);
  emit("states");
  show();
  return message !== CANCELLED;
}

function ended(photo, outcome) {
  photo.state = outcome;
  photo.area = photo.result?.area ?? photo.area;
  if (photo.result?.candidates.length) keepDraft(photo, { pose: null });
  if (photo !== state.photo) return;
  setArea(photo.area);
  if (outcome === "ready") return showStatus("The search ended without a result");
  // Until a candidate is chosen, the pose does not belong to this search.
  leave();
  showStatus(`Searched in ${photo.result.seconds.toFixed(1)} s`);
  emit("result");
  show();
  if (photo.result.candidates.length) choose(0);
  toView("answer");
}

// Ends a search that was begun before the page was loaded again.
async function rejoin(photo) {
  try {
    const record = (await server.records()).find((one) => one.id === photo.id);
    if (!record) return; // removed in another window
    photo.result = record.result;
    ended(photo, record.state);
  } catch (error) {
    report(error, "search");
  }
  emit("states");
  show();
}

const outcome = (result) => (result.answered ? "answered" : "no answer");

async function findAll() {
  for (const photo of state.photos.filter((one) => one.state === "ready")) {
    await choosePhoto(photo);
    if (photo === state.photo && photo.state === "ready") {
      if (!(await find(photo))) return;
    }
  }
}

export function choose(index) {
  const candidate = standing()?.candidates[index];
  if (!candidate) return;
  toCandidate(candidate, index);
  emit("chosen");
  show();
}

function show() {
  const { photo } = state;
  const isLoading = !state.rows;
  const busy = photo?.state === "matching";
  // What a person says about the camera may widen what is seen.
  const lacks = state.lacks && !("fov_deg" in known()) ? state.lacks : null;
  $("find").disabled = isLoading || busy || Boolean(lacks);
  $("progress").hidden = !busy;
  $("find-hint").hidden = Boolean(!photo || photo.area || busy);
  $("answer").replaceChildren(...(busy || isLoading ? [] : lacks ? missing(lacks) : photo?.result ? verdict(standing()) : []));
  list(busy ? [] : standing()?.candidates ?? []);
}

// Lists the candidates; the one that has the keyboard's focus keeps it.
function list(candidates) {
  const focused = document.activeElement?.dataset?.rank;
  $("candidates").replaceChildren(...candidates.map(row));
  if (focused !== undefined) $("candidates").querySelector(`[data-rank="${focused}"]`)?.focus();
}

// A verdict holds for a candidate that the search has judged, and for a fit that led to it.
function verdict(result) {
  if (!result) return ["The skyline, or what you know, has changed since the last search. Find the place again."];
  if (result.candidates.length && state.chosen === null) return ["The camera has left the candidates. Choose one to return to it."];
  if (state.chosen > 0) return ofOther(result.candidates[state.chosen].pose);
  const notes = result.notes.map((one) => element("p", { class: "claim" }, one));
  return [...(result.answered ? found(result) : missed(result)), ...notes];
}

function missing(lacks) {
  return [element("span", { class: "no" }, "No skyline of mountains is found: "), `${lacks}. Where the photo shows one, paint it with the tools.`];
}

function ofOther({ confidence }) {
  const sure = confidence === null ? "" : `${percent(confidence)} sure within 200 m. `;
  return [element("span", { class: "other" }, `Candidate ${state.chosen + 1}: `), sure, mapLink(state.pose)];
}

function found({ within_m, confidence }) {
  const near = within_m === null ? "" : ` within ${within_m} m`;
  const sure = confidence === null ? "" : `, ${percent(confidence)} sure`;
  return [element("span", { class: "yes" }, `Found${near}${sure}. `), mapLink(state.pose)];
}

function missed({ refusal }) {
  return [element("span", { class: "no" }, "No answer: "), `${refusal}. `,
    "Check the yellow skyline and mend it, fill in what you know, or fit by hand."];
}

function row({ pose }, index) {
  const sure = pose.confidence === null ? "" : percent(pose.confidence);
  return element("li", {}, element("button", { "aria-current": String(index === state.chosen), "data-rank": index, onclick: () => choose(index) },
    element("span", {}, String(index + 1)), element("span", {}, sure),
    element("span", {}, degrees(pose.lon, pose.lat, 4)), element("span", { class: "way", title: "Direction" }, `${pose.heading_deg.toFixed(0)}°`)));
}

function progressed(match) {
  const photo = state.photos.find((one) => one.id === match.photo);
  if (!match.done && IDLE.includes(photo?.state)) {
    photo.state = "matching"; // Another tab has begun this search, and either may cancel it.
    emit("states");
    show();
  }
  if (match.done && photo?.state === "matching" && !awaited.has(photo)) rejoin(photo);
  if (!photo || photo !== state.photo || match.done) return;
  $("bar").value = match.share;
  $("step").textContent = STEPS[match.step] ?? match.step;
}

export function start() {
  $("find").onclick = () => {
    $("bar").value = 0;
    $("step").textContent = "";
    find(state.photo);
    toView("progress");
  };
  $("find-all").onclick = findAll;
  $("cancel").onclick = () => server.cancel(state.photo).catch((error) => report(error, "search"));
  on("progress", progressed);
  on("choose", choose);
  for (const name of ["pose", "known"]) on(name, show);
  for (const name of ["photo", "known", "skyline"]) on(name, () => settle("search"));
  on("skyline", () => {
    const { result } = state.photo;
    if (result && state.photo.state !== "matching") {
      state.photo.state = result.skyline === state.version ? outcome(result) : "ready";
      emit("states");
    }
    show();
  });
  on("photo", (photo) => {
    show();
    if (photo && !toLeft(photo) && photo.result) choose(0);
    if (photo) toView(photo.result ? "answer" : "find");
  });
}

// The form of what the user knows about a photo's place, prefilled from the photo's EXIF.
import * as server from "./server.js";
import { draftOf, keepDraft } from "./kept.js";
import { $, alertUser, on, report, settle, state, emit, widest } from "./state.js";

const LEAST_KM = 0.5;
const MOST_KM = 100;
const NOTHING = { heading_deg: null, near: null, elevation_m: null, eye_height_m: null };
// Numbers that a slider's steps would round; each holds until its slider is moved.
const exact = {};
const last = {}; // the numbers that the fields have had last
// Whether the user gave the circle. A circle from a photo's own position belongs to that photo.
let isGiven = false;
let filled = null; // the photo that the form is about; none while it is filled

// A field that is emptied keeps its number, and shows it again when it is left.
function value(id) {
  const number = exact[id] ?? $(id).valueAsNumber;
  if (Number.isFinite(number)) last[id] = number;
  return last[id];
}

const isKnown = (name) => $(`${name}-known`).checked;
const isHeightKnown = () => $("eye").value !== "";
// The radius of the circle, rounded as it is shown.
const radiusKm = () => Number((LEAST_KM * (MOST_KM / LEAST_KM) ** value("radius")).toPrecision(2));
const shareOf = (km) => Math.log(km / LEAST_KM) / Math.log(MOST_KM / LEAST_KM);

function set(id, number) {
  exact[id] = number;
  $(id).value = number;
}

// The request that a search would send now; without a field of view the photo's own holds.
export function known() {
  const fov_deg = isKnown("fov") ? value("fov") : null;
  return {
    ...(fov_deg === (state.photo?.fov_deg ?? null) ? {} : { fov_deg }),
    heading_deg: isKnown("heading") ? [value("heading"), value("slack")] : null,
    near: isKnown("near") && state.circle ? [state.circle.lon, state.circle.lat, radiusKm()] : null,
    elevation_m: isKnown("elevation") ? [value("low"), value("high")] : null,
    eye_height_m: isHeightKnown() ? value("eye") : null,
  };
}

// The result of the photo's search as long as the same search would be made now, else null.
export function standing() {
  const result = state.photo?.result;
  const stands = result?.skyline === state.version && JSON.stringify(result?.asked) === JSON.stringify(known());
  return stands ? result : null;
}

const degrees = (id) => `${Number(value(id).toFixed(2))}°`;

function show() {
  $("fov-out").textContent = isKnown("fov") ? degrees("fov") : "unknown";
  $("heading-out").textContent = isKnown("heading") ? degrees("heading") : "unknown";
  $("slack-out").textContent = `± ${value("slack")}°`;
  $("radius-out").textContent = `${radiusKm()} km`;
  const inputs = { fov: ["fov"], heading: ["heading", "slack"], near: ["radius", "near-here"], elevation: ["low", "high"] };
  for (const [name, ids] of Object.entries(inputs)) for (const id of ids) $(id).disabled = !isKnown(name);
  if (document.activeElement !== $("near-place")) $("near-place").value = state.circle && isKnown("near") ? inWords(state.circle) : "";
  $("projection").disabled = !state.photo;
  $("known-summary").textContent = summary();
  if (filled) keepDraft(filled, { known: known() });
  emit("known");
}

const inWords = ({ lat, lon }) => `${lat.toFixed(5)}, ${lon.toFixed(5)}`;

const numberOf = (name) => `(?<${name}>-?\\d+(?:\\.\\d+)?)\\s*°?`;
const PLACES = [
  `^${numberOf("one")}\\s*(?<side>[NSEW]?)[\\s,;]+${numberOf("other")}\\s*(?<across>[NSEW]?)$`,
  `^(?<side>[NSEW])\\s*${numberOf("one")}[\\s,;]+(?<across>[NSEW])\\s*${numberOf("other")}$`,
].map((one) => new RegExp(one, "i"));

// Reads a place as people write and copy it: 46.8, -9.84, 46.8 N 9.84 W or W 9.84, N 46.8. Without
// letters the latitude is the first. What is read only in part would be another place: null.
export function placeIn(text) {
  const plain = text.trim().replaceAll("−", "-");
  const found = PLACES.map((one) => plain.match(one)).find(Boolean)?.groups;
  if (!found) return null;
  const { one, side, other, across } = found;
  const isSwapped = /[ew]/i.test(side) || /[ns]/i.test(across);
  if (isSwapped && (/[ns]/i.test(side) || /[ew]/i.test(across))) return null;
  const signed = [[one, side], [other, across]].map(([number, of]) => /[sw]/i.test(of) ? -Math.abs(number) : Number(number));
  const [lat, lon] = isSwapped ? signed.reverse() : signed;
  return Math.abs(lat) <= 90 && Math.abs(lon) <= 180 ? { lat, lon } : null;
}

function typed() {
  const text = $("near-place").value;
  settle("place");
  if (!text.trim()) {
    isGiven = true;
    $("near-known").checked = false;
    return showCircle();
  }
  const place = placeIn(text);
  if (!place) return alertUser("A place is a latitude and a longitude in degrees, such as 46.80, 9.84.", "place");
  searchAround(place);
}

// Limits the search to the circle round a place.
export function searchAround(place) {
  isGiven = true;
  $("near-known").checked = true;
  showCircle(place);
}

function summary() {
  const parts = [
    isKnown("fov") && `${degrees("fov")} wide`,
    isKnown("heading") && `towards ${degrees("heading")}`,
    isKnown("near") && `within ${radiusKm()} km`,
    isKnown("elevation") && `${value("low")} to ${value("high")} m`,
    isHeightKnown() && `${$("eye").value} m above the ground`,
  ].filter(Boolean);
  const offered = state.photo?.lonlat_deg && !isKnown("near")
    ? " The photo notes its place: tick “In the circle” to search near it." : "";
  return (parts.length ? `(${parts.join(", ")})` : "(nothing yet)") + offered;
}

// Shows the circle on the map, if it limits the search; its middle moves to a place that is given.
function showCircle(middle = null) {
  if (middle) state.circle = middle;
  emit("circle", isKnown("near") ? radiusKm() : null);
  show();
}

// Fills the form with what was said of the photo last, or the request of its last search. Before
// the first, the field of view is the photo's own, and its place and direction are offered.
function fromPhoto(photo) {
  filled = null;
  if (!photo) return;
  const said = draftOf(photo).known;
  const asked = said ?? photo.result?.asked ?? { ...NOTHING, near: photo.near };
  // A field of view that the projection cannot have was said of another projection.
  const isOwnFov = asked.fov_deg === undefined || asked.fov_deg > widest(photo);
  const fov_deg = isOwnFov ? photo.fov_deg : asked.fov_deg;
  $("projection").value = photo.projection;
  $("fov").max = widest(photo);
  $("fov-known").checked = fov_deg !== null;
  $("heading-known").checked = asked.heading_deg !== null;
  const near = asked.near ?? null;
  if (near) isGiven = !isOwn(near, photo);
  // A circle that the user gave before the photo stays, where there is no store to search instead.
  if (said || near || state.area || photo.lonlat_deg || !isGiven) $("near-known").checked = Boolean(near);
  $("elevation-known").checked = asked.elevation_m !== null;
  fillNumbers(photo, { ...asked, near }, fov_deg ?? photo.fov_deg);
  const [lon, lat] = near ?? photo.lonlat_deg ?? [];
  showCircle(lon === undefined ? null : { lon, lat });
  filled = photo;
}

const isOwn = ([lon, lat], { near }) => near?.[0] === lon && near[1] === lat;

function fillNumbers(photo, asked, fov_deg) {
  const heading_deg = asked.heading_deg?.[0] ?? photo.heading_deg ?? null;
  if (fov_deg) set("fov", fov_deg);
  if (heading_deg !== null) set("heading", heading_deg);
  if (asked.heading_deg) set("slack", asked.heading_deg[1]);
  if (asked.near) set("radius", shareOf(asked.near[2]));
  if (asked.elevation_m) {
    set("low", asked.elevation_m[0]);
    set("high", asked.elevation_m[1]);
  }
  $("eye").value = "";
  if (asked.eye_height_m !== null) set("eye", asked.eye_height_m);
}

// Another projection makes another skyline, and the file's field of view may not hold.
async function project() {
  const { photo } = state;
  settle("projection");
  try {
    await server.project(photo, $("projection").value);
    Object.assign(photo, (await server.records()).find((one) => one.id === photo.id));
    emit("projected", photo);
  } catch (error) {
    report(error, "projection");
    $("projection").value = photo.projection;
  }
}

export function start() {
  $("projection").onchange = project;
  for (const name of ["fov", "heading", "elevation"]) $(`${name}-known`).onchange = show;
  for (const id of ["fov", "heading", "slack", "low", "high", "eye", "radius"]) {
    $(id).oninput = () => {
      delete exact[id];
      id === "radius" ? showCircle() : show();
    };
  }
  for (const id of ["low", "high"]) $(id).onchange = () => ($(id).value = value(id));
  $("near-known").onchange = () => {
    isGiven = true;
    showCircle();
  };
  $("near-place").onchange = typed;
  $("near-place").onfocus = () => $("near-place").select();
  $("known-form").onsubmit = (event) => event.preventDefault();
  on("photo", fromPhoto);
  on("circled", show);
  show();
}

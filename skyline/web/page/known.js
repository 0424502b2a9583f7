// The form of what the user knows about a photo's place, prefilled from the photo's EXIF.
import { $, on, state, emit, widest } from "./state.js";

const LEAST_KM = 0.5, MOST_KM = 100, NOTHING = { heading: null, near: null, elevation: null, eyeHeight: null };
// Numbers that a slider's steps would round; each holds until its slider is moved.
const exact = {};

const value = (id) => exact[id] ?? $(id).valueAsNumber;
const isKnown = (name) => $(`${name}-known`).checked;
// The radius of the circle, rounded as it is shown.
const km = () => Number((LEAST_KM * (MOST_KM / LEAST_KM) ** value("radius")).toPrecision(2));

function set(id, number) {
  exact[id] = number;
  $(id).value = number;
}

// The request that a search would send now; without a field of view the photo's own holds.
export function known() {
  const fov = isKnown("fov") ? value("fov") : null;
  return {
    ...(fov === (state.photo?.fov ?? null) ? {} : { fov }),
    heading: isKnown("heading") ? [value("heading"), value("slack")] : null,
    near: isKnown("near") ? [state.circle.lon, state.circle.lat, km()] : null,
    elevation: isKnown("elevation") ? [value("low"), value("high")] : null,
    eyeHeight: $("eye").value === "" ? null : value("eye"),
  };
}

// The result of the photo's search as long as the same search would be made now, else null.
export function standing() {
  const result = state.photo?.result;
  const stands = result?.skyline === state.version && JSON.stringify(result?.asked) === JSON.stringify(known());
  return stands ? result : null;
}

function show() {
  const angle = (id) => `${Number(value(id).toFixed(2))}°`;
  $("fov-out").textContent = isKnown("fov") ? angle("fov") : "unknown";
  $("fov").disabled = !isKnown("fov");
  $("heading-out").textContent = isKnown("heading") ? angle("heading") : "unknown";
  $("heading").disabled = $("slack").disabled = !isKnown("heading");
  $("slack-out").textContent = `± ${value("slack")}°`;
  $("radius-out").textContent = `${km()} km`;
  $("radius").disabled = $("near-here").disabled = !isKnown("near");
  $("low").disabled = $("high").disabled = !isKnown("elevation");
  const parts = [
    isKnown("fov") && `${angle("fov")} wide`,
    isKnown("heading") && `towards ${angle("heading")}`,
    isKnown("near") && `within ${km()} km`,
    isKnown("elevation") && `${$("low").value} to ${$("high").value} m`,
    $("eye").value !== "" && `${$("eye").value} m above the ground`,
  ].filter(Boolean);
  $("known-summary").textContent = parts.length ? `(${parts.join(", ")})` : "(nothing yet)";
  if (state.photo?.lonlat && !isKnown("near")) {
    $("known-summary").textContent += " The photo notes its place: tick “In the circle” to search near it.";
  }
  emit("known");
}

// Shows the circle on the map, if it limits the search; its middle moves to a place that is given.
export function showCircle(middle = null) {
  if (middle) state.circle = middle;
  emit("circle", isKnown("near") ? km() : null);
  show();
}

// Fills the form with the request of the photo's last search. Before the first, the field of view
// is the photo's own, and its place and direction are offered.
function fromPhoto(photo) {
  if (!photo) return;
  const asked = photo.result?.asked ?? NOTHING;
  const fov = "fov" in asked ? asked.fov : photo.fov;
  $("fov").max = widest(photo);
  $("fov-known").checked = fov !== null;
  for (const name of ["heading", "near", "elevation"]) $(`${name}-known`).checked = asked[name] !== null;
  if (fov ?? photo.fov) set("fov", fov ?? photo.fov);
  const heading = asked.heading?.[0] ?? photo.heading ?? null;
  if (heading !== null) set("heading", heading);
  if (asked.heading) set("slack", asked.heading[1]);
  if (asked.near) set("radius", Math.log(asked.near[2] / LEAST_KM) / Math.log(MOST_KM / LEAST_KM));
  asked.elevation?.forEach((at, k) => set(["low", "high"][k], at));
  $("eye").value = "";
  if (asked.eyeHeight !== null) set("eye", asked.eyeHeight);
  const [lon, lat] = asked.near ?? photo.lonlat ?? [];
  showCircle(lon === undefined ? null : { lon, lat });
}

export function start() {
  for (const name of ["fov", "heading", "elevation"]) $(`${name}-known`).onchange = show;
  for (const id of ["fov", "heading", "slack", "low", "high", "eye", "radius"]) {
    $(id).oninput = () => {
      delete exact[id];
      id === "radius" ? showCircle() : show();
    };
  }
  $("near-known").onchange = () => showCircle();
  $("known-form").onsubmit = (event) => event.preventDefault();
  on("photo", fromPhoto);
  on("circled", show);
  show();
}

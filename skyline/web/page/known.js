// What a person knows of where a photo was taken, and what the photo says itself.
import { $, alertUser, on, state, widest } from "./state.js";
import { circled, middle, showCircle } from "./map.js";

const LEAST_KM = 0.5, MOST_KM = 100;
const km = () => LEAST_KM * (MOST_KM / LEAST_KM) ** Number($("radius").value);

export function known() {
  const on_ = (name) => $(`${name}-known`).checked;
  const value = (id) => $(id).valueAsNumber;
  return {
    fov: on_("fov") ? value("fov") : null,
    heading: on_("heading") ? { deg: value("heading"), slack: value("slack") } : null,
    near: on_("near") ? circled() : null,
    elevation: on_("elevation") ? { low: value("low"), high: value("high") } : null,
    // What nobody has changed is not known: a camera may have stood on a roof.
    eyeHeight: $("eye").value === $("eye").defaultValue ? null : value("eye"),
  };
}

function show() {
  $("fov-out").textContent = $("fov-known").checked ? `${Number($("fov").value).toFixed(1)}°` : "unknown";
  $("fov").disabled = !$("fov-known").checked;
  $("heading-out").textContent = $("heading-known").checked ? `${$("heading").value}°` : "unknown";
  $("heading").disabled = $("slack").disabled = !$("heading-known").checked;
  $("slack-out").textContent = `± ${$("slack").value}°`;
  $("radius-out").textContent = `${km().toPrecision(2)} km`;
  $("radius").disabled = $("near-here").disabled = !$("near-known").checked;
  $("low").disabled = $("high").disabled = !$("elevation-known").checked;
  const told = [
    $("fov-known").checked && `${Number($("fov").value).toFixed(0)}° wide`,
    $("heading-known").checked && `towards ${$("heading").value}°`,
    $("near-known").checked && `within ${km().toPrecision(2)} km`,
    $("elevation-known").checked && `${$("low").value} to ${$("high").value} m`,
  ].filter(Boolean);
  $("known-said").textContent = told.length ? `(${told.join(", ")})` : "(nothing yet)";
}

function circle(place = null) {
  showCircle($("near-known").checked ? km() : null, place);
  show();
}

// A photo's own word is taken for its field of view; its place and direction are offered.
function fromPhoto(photo) {
  if (!photo) return;
  $("fov-known").checked = Boolean(photo.fov);
  $("fov").max = widest(photo);
  if (photo.fov) $("fov").value = photo.fov;
  for (const name of ["heading", "near", "elevation"]) $(`${name}-known`).checked = false;
  if (photo.heading !== null && photo.heading !== undefined) $("heading").value = Math.round(photo.heading);
  circle(photo.lonlat ? [photo.lonlat[1], photo.lonlat[0]] : null);
  if (photo.lonlat) {
    $("known-said").textContent += " The photo says its place: tick “In the circle” to search near it.";
  }
}

export function start() {
  for (const name of ["fov", "heading", "elevation"]) $(`${name}-known`).onchange = show;
  for (const id of ["fov", "heading", "slack", "low", "high", "eye"]) $(id).oninput = show;
  $("near-known").onchange = () => circle();
  $("radius").oninput = () => circle();
  $("near-here").onclick = () => circle(middle());
  $("known-form").onsubmit = (event) => event.preventDefault();
  on("photo", fromPhoto);
  show();
}

export function checked() {
  const low = $("low").valueAsNumber, high = $("high").valueAsNumber;
  if ($("elevation-known").checked && !(low < high)) {
    alertUser("the lowest elevation must be below the highest");
    return false;
  }
  return Boolean(state.photo);
}

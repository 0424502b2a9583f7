// The state that the parts of the page share, and the events by which they learn of changes.
// What belongs to the photo that is shown:
const OF_PHOTO = {
  rows: null, // Float32Array of the photo's columns: NaN where left out
  trust: null, // Float32Array, 0 to 1
  others: null, // Float32Array, rows of other crests that may be the skyline
  lacks: null, // why the skyline is too little to be searched, if it is
  version: null, // distinguishes the skyline from others of the same photo
  trace: null, // text of the skyline's file
  chosen: null, // index of the candidate that was chosen, or that the fit led to
  pose: null, // a record as `NotedPose` reads it, with eye_height_m
  origin: null, // of the pose: "found" (the chosen candidate), "fitted" or "hand"
  fit: null, // result of the last fit, as long as the pose is the fitted one
  sight: null, // the skyline rendered at the pose
};

export const state = {
  server: null, // the server's description of itself
  area: null, // where the photo is searched; null if it was not made yet
  photos: [], // records in the list's order
  circle: null, // {lon, lat}, the middle of the circle that limits the search
  typing: false, // whether a number of the pose is being typed
  photo: null, // the record that is shown
  ...OF_PHOTO,
};

// Another photo is shown, or none: nothing is known of it yet.
export const setPhoto = (photo) => Object.assign(state, OF_PHOTO, { photo });

// The photo that is shown is searched in other stores, or in none yet.
export function setArea(area) {
  if (area?.id === state.area?.id) return;
  state.area = area;
  emit("area", area);
}

const events = new EventTarget();

export const on = (name, handler) => events.addEventListener(name, (event) => handler(event.detail));
export const emit = (name, detail) => events.dispatchEvent(new CustomEvent(name, { detail }));

// The step, right and down, of each arrow key.
export const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

export const $ = (id) => document.getElementById(id);

export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (name === "class") made.className = value;
    else if (value !== null && value !== undefined) made.setAttribute(name, value);
  }
  made.append(...children);
  return made;
}

const MOST_FOV_DEG = { perspective: 120, fisheye: 180, cylindrical: 360, equirectangular: 360 };

// The widest field of view that the page offers for a photo.
export const widest = (photo) => MOST_FOV_DEG[photo?.projection] ?? 120;

const PHONE = matchMedia("(max-width: 640px), (max-height: 480px)");

// Whether the page is one column that scrolls, and is worked by finger: as in page.css.
export const isPhone = () => PHONE.matches && matchMedia("(pointer: coarse)").matches;

export const onPhone = (handler) => PHONE.addEventListener("change", handler);

// Scrolls what is next to be used into view, where the page scrolls.
export function toView(id) {
  if (PHONE.matches) $(id).scrollIntoView({ block: "nearest" });
}

export function showStatus(text) {
  $("status").textContent = text;
}

// Shows a message in place of the last one of its kind; it stays until it is settled or closed.
export function alertUser(text, kind) {
  settle(kind);
  const close = element("button", { onclick: () => settle(kind) }, "Close");
  $("alerts").append(element("div", { class: "alert", "data-kind": kind }, element("span", {}, text), close));
}

// Shows why something failed; an error may name its own kind.
export const report = (error, kind) => alertUser(error.message, error.kind ?? kind);

// Takes away messages that are no longer true.
export function settle(...kinds) {
  for (const box of [...$("alerts").children]) if (kinds.includes(box.dataset.kind)) box.remove();
}

// A link for the user to follow: the page itself loads nothing from other machines.
export function mapLink({ lon, lat }) {
  const north = lat.toFixed(5);
  const east = lon.toFixed(5);
  const href = `https://www.openstreetmap.org/?mlat=${north}&mlon=${east}#map=14/${north}/${east}`;
  return element("a", { href, target: "_blank", rel: "noreferrer", title: "See it on OpenStreetMap" }, degrees(lon, lat));
}

export const percent = (confidence) => `${Math.round(100 * confidence)} %`;

export const degrees = (lon, lat, decimals = 5) =>
  `${Math.abs(lat).toFixed(decimals)}° ${lat < 0 ? "S" : "N"}  ${Math.abs(lon).toFixed(decimals)}° ${lon < 0 ? "W" : "E"}`;

// Strokes, kept in the browser until they are saved, by the content of their photo. So they are found
// again whatever happens to the server, the page and the photo's name.
import { alertUser, emit, settle, state } from "./state.js";

const PREFIX = "skyline strokes ";
const key = (photo) => PREFIX + photo.content;

// The strokes of a photo and the trace under them; null if all is saved.
export function workOn(photo) {
  const text = localStorage.getItem(key(photo));
  return text && JSON.parse(text);
}

// Names of other photos with strokes.
export function keptFor(photos) {
  const known = new Set(photos.map(key));
  const others = Object.keys(localStorage).filter((one) => one.startsWith(PREFIX) && !known.has(one));
  return others.map((one) => JSON.parse(localStorage.getItem(one)).name);
}

export function keep(photo) {
  photo.unsaved = photo.strokes.length > 0;
  emit("unsaved");
  if (!photo.unsaved) return localStorage.removeItem(key(photo));
  try {
    localStorage.setItem(key(photo), JSON.stringify({ name: photo.name, strokes: photo.strokes, trace: photo.trace }));
    settle("kept");
  } catch {
    alertUser("The browser has no room for more strokes: save the trace, or they are lost with this page.", "kept");
  }
}

export function saved(photo) {
  photo.unsaved = false;
  emit("unsaved");
  localStorage.removeItem(key(photo));
}

export function start() {
  addEventListener("beforeunload", (event) => {
    if (state.photos.some((photo) => photo.unsaved)) event.preventDefault();
  });
}

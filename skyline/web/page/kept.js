// Strokes, kept in the browser until they are saved, by the content of their photo. So they are found
// again whatever happens to the server, the page and the photo's name.
import { alertUser, emit, settle, state } from "./state.js";

const PREFIX = "skyline strokes ";
const DRAFT = "skyline draft ";
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

// What a person says of a photo, and the pose that its camera was set to. The tab keeps them while
// other photos are shown, and if the page is loaded again.
export const draftOf = (photo) => JSON.parse(sessionStorage.getItem(DRAFT + photo.content)) ?? {};
export const keepDraft = (photo, part) =>
  sessionStorage.setItem(DRAFT + photo.content, JSON.stringify({ ...draftOf(photo), ...part }));
export const forgetDraft = (photo) => sessionStorage.removeItem(DRAFT + photo.content);

export function start() {
  addEventListener("beforeunload", (event) => {
    if (state.photos.some((photo) => photo.unsaved)) event.preventDefault();
  });
}

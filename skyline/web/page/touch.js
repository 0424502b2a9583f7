// Two fingers on the photo move and zoom it.
import { $, emit } from "./state.js";
import { pan, zoom } from "./view.js";

const canvas = $("photo");
const fingers = new Map(); // where on the canvas each finger is

function place(event) {
  const box = canvas.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
}

function pair() {
  const [[left, top], [right, bottom]] = fingers.values();
  return { middle: [(left + right) / 2, (top + bottom) / 2], apart: Math.hypot(right - left, bottom - top) };
}

function down(event) {
  if (event.pointerType !== "touch") return;
  fingers.set(event.pointerId, place(event));
  if (fingers.size === 2) emit("pinch");
}

function moved(event) {
  if (!fingers.has(event.pointerId)) return;
  const before = fingers.size === 2 && pair();
  fingers.set(event.pointerId, place(event));
  if (!before) return;
  const after = pair();
  pan(after.middle[0] - before.middle[0], after.middle[1] - before.middle[1]);
  zoom(after.apart / Math.max(1, before.apart), after.middle);
}

export function start() {
  canvas.addEventListener("pointerdown", down);
  canvas.addEventListener("pointermove", moved);
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
  // Else the browser would scroll the page with two fingers.
  const keep = (event) => event.touches.length > 1 && event.preventDefault();
  for (const name of ["touchstart", "touchmove"]) canvas.addEventListener(name, keep, { passive: false });
}

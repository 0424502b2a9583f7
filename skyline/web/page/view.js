// The photo on its canvas: zoom, pan and loupe; layers.js draws over it.
import * as layers from "./layers.js";
import { $, on, state } from "./state.js";

const canvas = $("photo");
const loupe = $("loupe");
const LOUPE_PX = 180;
const LOUPE_TIMES = 6;
const MARGIN = 0.98;
export const view = { scale: 1, left: 0, top: 0, width: 1, height: 1 };
export const marks = { stroke: null, cross: null, pointer: null, brush: 0 };
let image = null;
let fitted = true;
let due = false;

export function show(bitmap) {
  image?.close();
  image = bitmap;
  marks.stroke = null;
  marks.cross = null;
  fit();
}

export const inPhoto = (event) => {
  const box = canvas.getBoundingClientRect();
  const at = (place, start) => (place - start) / view.scale - 0.5;
  return [at(event.clientX - box.left, view.left), at(event.clientY - box.top, view.top)];
};

export function fit() {
  fitted = true;
  if (!state.photo?.width_px) return draw();
  const { width_px, height_px } = state.photo;
  view.scale = MARGIN * Math.min(view.width / width_px, view.height / height_px);
  view.left = (view.width - width_px * view.scale) / 2;
  view.top = (view.height - height_px * view.scale) / 2;
  draw();
}

export function zoom(times, about = null) {
  const [across, down] = about || (marks.cross ? onScreen(marks.cross) : [view.width / 2, view.height / 2]);
  const scale = Math.min(40, Math.max(0.02, view.scale * times));
  view.left = across - ((across - view.left) * scale) / view.scale;
  view.top = down - ((down - view.top) * scale) / view.scale;
  view.scale = scale;
  fitted = false;
  draw();
}

const onScreen = ([column, row]) => [layers.x(view, column), layers.y(view, row)];

export function pan(across, down) {
  view.left += across;
  view.top += down;
  fitted = false;
  draw();
}

export function keepInView(at) {
  const [across, down] = onScreen(at);
  const edge = 30;
  const shift = (value, size) => (value < edge ? edge - value : value > size - edge ? size - edge - value : 0);
  pan(shift(across, view.width), shift(down, view.height));
}

export function draw() {
  if (due) return;
  due = true;
  requestAnimationFrame(() => {
    due = false;
    paint(canvas, view, devicePixelRatio);
    paintLoupe();
  });
}

function paint(target, at, ratio) {
  const ctx = target.getContext("2d");
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  ctx.clearRect(0, 0, at.width, at.height);
  if (!image || !state.photo?.width_px) return;
  const { width_px, height_px } = state.photo;
  ctx.imageSmoothingEnabled = at.scale < 2;
  ctx.drawImage(image, at.left, at.top, width_px * at.scale, height_px * at.scale);
  if (state.rows) layers.drawLeftOut(ctx, at, state.rows, height_px);
  if (state.sight) {
    if (state.rows) layers.drawGaps(ctx, at, state.sight, state.rows);
    layers.drawRendered(ctx, at, state.sight);
  }
  // The thin line is drawn over the broad one, so that both show where they agree.
  if (state.rows) layers.drawFound(ctx, at, state.rows, state.trust, state.others);
  if (state.sight?.summits) layers.drawSummits(ctx, at, state.sight.summits, $("gap").offsetHeight);
  // Strokes that are not in the skyline yet stay in sight.
  const waiting = state.photo.strokes?.slice(state.photo.solved) ?? [];
  for (const stroke of waiting.concat(marks.stroke ?? [])) layers.drawStroke(ctx, at, stroke);
  const cross = marks.cross || (marks.brush ? marks.pointer : null);
  if (cross) layers.drawCross(ctx, at, cross, marks.brush * at.scale);
}

function paintLoupe() {
  const at = marks.cross || marks.pointer;
  loupe.hidden = !($("loupe-on").checked && at && image);
  if (loupe.hidden) return;
  const scale = Math.max(2, LOUPE_TIMES * view.scale);
  paint(loupe, {
    scale,
    left: LOUPE_PX / 2 - (at[0] + 0.5) * scale,
    top: LOUPE_PX / 2 - (at[1] + 0.5) * scale,
    width: LOUPE_PX,
    height: LOUPE_PX,
  }, 1);
  const [across, down] = onScreen(at);
  const beside = across > view.width / 2 ? across - LOUPE_PX - 24 : across + 24;
  loupe.style.left = `${Math.round(beside)}px`;
  loupe.style.top = `${Math.round(Math.min(Math.max(4, down - LOUPE_PX / 2), view.height - LOUPE_PX - 4))}px`;
}

function resize() {
  const { width, height } = canvas.getBoundingClientRect();
  Object.assign(view, { width, height });
  canvas.width = Math.round(width * devicePixelRatio);
  canvas.height = Math.round(height * devicePixelRatio);
  fitted ? fit() : draw();
}

export function start() {
  new ResizeObserver(resize).observe(canvas);
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const box = canvas.getBoundingClientRect();
    zoom(Math.exp(-event.deltaY * 0.0015), [event.clientX - box.left, event.clientY - box.top]);
  }, { passive: false });
  canvas.addEventListener("pointermove", (event) => {
    marks.pointer = inPhoto(event);
    marks.cross = null;
    if (marks.brush || $("loupe-on").checked) draw();
  });
  canvas.addEventListener("pointerleave", () => {
    marks.pointer = null;
    draw();
  });
  $("zoom-in").onclick = () => zoom(1.5);
  $("zoom-out").onclick = () => zoom(1 / 1.5);
  $("zoom-fit").onclick = fit;
  $("zoom-pixel").onclick = () => zoom(1 / view.scale);
  $("loupe-on").onchange = draw;
  for (const name of ["skyline", "sight", "pose"]) on(name, draw);
}

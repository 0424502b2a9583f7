// Strokes over the photo; the skyline is found again after each.
import * as server from "./server.js";
import { $, ARROWS, alertUser, emit, on, report, settle, showStatus, state } from "./state.js";
import { keep } from "./kept.js";
import { draw, fit, inPhoto, keepInView, marks, pan, view, zoom } from "./view.js";
import { release, turnBy } from "./hand.js";

const canvas = $("photo");
const PAINTS = ["sky", "ground", "line", "erase"];
const KEYS = { m: "move", s: "sky", g: "ground", l: "line", e: "erase", t: "turn" };
const undone = [];
const unsent = new Set(); // photos with strokes that the server has not seen
let solving = false;

const tool = () => document.querySelector("input[name=tool]:checked").value;
const radius = () => (tool() === "line" ? 0 : Number($("brush").value) / view.scale / 2);

function choose(name) {
  document.querySelector(`input[name=tool][value=${name}]`).checked = true;
  chosen();
}

function chosen() {
  marks.brush = PAINTS.includes(tool()) ? Math.max(radius(), 2 / view.scale) : 0;
  canvas.style.cursor = marks.brush ? "crosshair" : tool() === "turn" ? "ew-resize" : "grab";
  draw();
}

const rounded = (place) => place.map((one) => Number(one.toFixed(2)));

function begin(at) {
  marks.stroke = { kind: tool(), radius: radius(), points: [rounded(at)] };
}

function finish() {
  const stroke = marks.stroke;
  marks.stroke = null;
  if (!stroke) return;
  undone.length = 0;
  state.photo.strokes.push(stroke);
  solve();
}

function undo() {
  const stroke = state.photo?.strokes.pop();
  if (!stroke) return;
  undone.push(stroke);
  solve();
}

function redo() {
  const stroke = undone.pop();
  if (!stroke) return;
  state.photo.strokes.push(stroke);
  solve();
}

function solve() {
  buttons();
  keep(state.photo);
  unsent.add(state.photo);
  draw();
  send();
}

// One request at a time; strokes drawn meanwhile go with the next. Without a server they wait.
async function send() {
  if (solving) return;
  solving = true;
  while (unsent.size) {
    const [photo] = unsent, strokes = [...photo.strokes], began = performance.now();
    if (!state.photos.includes(photo)) {
      unsent.delete(photo);
      continue;
    }
    try {
      const skyline = await server.skyline(photo, strokes);
      photo.solved = strokes.length;
      if (isSame(strokes, photo.strokes)) unsent.delete(photo);
      performance.measure("stroke", { start: began });
      settle("strokes");
      if (photo !== state.photo) continue;
      showSkyline(skyline);
      showShare();
    } catch (error) {
      report(error, "strokes");
      if (error.kind === "server") break;
      unsent.delete(photo);
    }
  }
  solving = false;
}

const isSame = (some, others) => some.length === others.length && some.every((one, k) => one === others[k]);

export const waits = (photo) => unsent.has(photo);

// Takes up the work on a photo that the server does not know.
export async function resume(photo, { strokes, trace }) {
  Object.assign(photo, { strokes, trace });
  if (trace) await server.loadTrace(photo, trace);
  const count = strokes.length;
  if (count) await server.skyline(photo, strokes);
  photo.solved = count;
  if (count === strokes.length) unsent.delete(photo);
}

export function showShare(before = "Skyline") {
  const share = state.rows.reduce((sum, row) => sum + !Number.isNaN(row), 0) / state.rows.length;
  showStatus(`${before} in ${Math.round(100 * share)} % of the columns`);
}

export function showSkyline(skyline) {
  Object.assign(state, skyline);
  buttons();
  emit("skyline");
}

export function buttons() {
  $("undo").disabled = !state.photo?.strokes?.length;
  $("redo").disabled = !undone.length;
}

export function forget() {
  undone.length = 0;
}

function dragging(event) {
  canvas.setPointerCapture(event.pointerId);
  let last = [event.clientX, event.clientY];
  const paints = marks.brush && event.button === 0;
  if (paints) begin(inPhoto(event));
  const move = (next) => {
    const by = [next.clientX - last[0], next.clientY - last[1]];
    last = [next.clientX, next.clientY];
    if (paints) {
      const all = next.getCoalescedEvents?.() ?? [next];
      marks.stroke.points.push(...(all.length ? all : [next]).map((one) => rounded(inPhoto(one))));
      draw();
    } else if (tool() === "turn" && event.button === 0) turnBy(by[0] / view.scale, by[1] / view.scale, true);
    else pan(...by);
  };
  const end = () => {
    canvas.removeEventListener("pointermove", move);
    if (paints) finish();
    else if (tool() === "turn") release();
  };
  canvas.addEventListener("pointermove", move);
  canvas.addEventListener("lostpointercapture", end, { once: true });
}

function moveCross([across, down], event) {
  const step = (event.shiftKey ? 40 : 6) / view.scale;
  if (tool() === "turn") return turnBy(across * step, down * step, false);
  if (!marks.brush) return pan(-across * step * view.scale * 5, -down * step * view.scale * 5);
  const { width, height } = state.photo;
  const at = marks.cross || [width / 2, height / 2];
  marks.cross = [
    Math.min(width - 1, Math.max(0, at[0] + across * step)),
    Math.min(height - 1, Math.max(0, at[1] + down * step)),
  ];
  marks.stroke?.points.push(rounded(marks.cross));
  keepInView(marks.cross);
}

function pressed(event) {
  if (event.altKey || !state.photo) return;
  const control = event.ctrlKey || event.metaKey;
  if (control && event.key.toLowerCase() === "z") event.shiftKey ? redo() : undo();
  else if (control) return;
  else if (ARROWS[event.key]) moveCross(ARROWS[event.key], event);
  else if (KEYS[event.key.toLowerCase()]) choose(KEYS[event.key.toLowerCase()]);
  else if (event.key === "+" || event.key === "=") zoom(1.5);
  else if (event.key === "-") zoom(1 / 1.5);
  else if (event.key === "0") fit();
  else if (event.key === "1") zoom(1 / view.scale);
  else if (event.key === "[" || event.key === "]") {
    $("brush").value = Number($("brush").value) * (event.key === "]" ? 1.25 : 0.8);
    chosen();
  } else if ((event.key === "Enter" || event.key === " ") && marks.brush) {
    if (marks.stroke) finish();
    else {
      marks.cross ||= [state.photo.width / 2, state.photo.height / 2];
      begin(marks.cross);
      draw();
    }
  } else if (event.key === "Escape") {
    marks.stroke = marks.cross = null;
    draw();
  } else return;
  event.preventDefault();
}

export async function traceFrom(file) {
  const photo = state.photo;
  if (!photo) return alertUser(`${file.name} is a trace; first add the photo that it belongs to`, "trace");
  settle("trace");
  try {
    const trace = await file.text();
    const skyline = await server.loadTrace(photo, trace);
    Object.assign(photo, { strokes: [], trace, solved: 0 });
    keep(photo);
    if (photo !== state.photo) return;
    forget();
    showSkyline(skyline);
    showStatus(`${file.name} loaded`);
  } catch (error) {
    report(error, "trace");
  }
}

export function start() {
  for (const input of document.querySelectorAll("input[name=tool]")) input.onchange = chosen;
  $("brush").oninput = chosen;
  canvas.addEventListener("pointerdown", (event) => state.photo && dragging(event));
  canvas.addEventListener("pointermove", () => {
    if (marks.brush) marks.brush = Math.max(radius(), 2 / view.scale);
  });
  canvas.addEventListener("keydown", pressed);
  document.addEventListener("keydown", (event) => {
    // The photo's keys work on the whole page; letters of tools also while a button has the focus.
    const isTool = KEYS[event.key.toLowerCase()] && !event.ctrlKey && !event.metaKey;
    if (event.target === document.body || (isTool && !event.target.matches("#photo, input[type=number]"))) pressed(event);
  });
  on("connected", send);
  $("undo").onclick = undo;
  $("redo").onclick = redo;
  $("load-trace").onclick = () => $("trace-file").click();
  $("trace-file").onchange = async () => {
    for (const file of $("trace-file").files) await traceFrom(file);
    $("trace-file").value = "";
  };
  chosen();
}

// The map: relief from the elevation model, candidates and their views, the camera, the circle.
import * as server from "./server.js";
import { $, ARROWS, alertUser, degrees, element, isPhone, on, onPhone, percent, state, emit } from "./state.js";
import { moveTo, placeAt, release } from "./hand.js";
import { searchAround, standing } from "./known.js";

const L = window.L;
const REACH_M = 2000; // how far a view is drawn
const HANDLE_PX = [74, 102, 130]; // distances of the handle from the camera, the first that is free
const APART_PX = 26;
const MOST_NAMES = 60;
const STEPS_DEG = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 30, 90]; // steps between lines on an empty map
const NAME_PX = [90, 50]; // room for the name of such a line, across and down
const EARTH_M = 6371008.8;
let map;
let relief = null; // the area's relief
let named; // the names
let names = []; // the gazetteer's names, with longitude and latitude
let frame; // the area's frame; without one, lines of latitude and longitude
let camera;
let handle; // turns the camera
let cone; // the view of the camera
let noted; // the place noted in the photo
let spots; // the candidates
let circle; // limits the search
let centre; // the circle's middle
let middleLon = 0;

// The map runs half a turn either way from the store, so that it may cross the antimeridian.
const onMap = (lat, lon) => [lat, lon + 360 * Math.round((middleLon - lon) / 360)];
const offMap = ({ lat, lng }) => ({ lon: lng - 360 * Math.round(lng / 360), lat });

const icon = (name, size, text = "") =>
  L.divIcon({ className: name, iconSize: [size, size], html: text });

// A step along a great circle, accurate enough for a map.
function away([lat, lon], heading_deg, metres) {
  const turn = (heading_deg * Math.PI) / 180;
  const step = (metres / EARTH_M) * (180 / Math.PI);
  return [lat + step * Math.cos(turn), lon + (step * Math.sin(turn)) / Math.cos((lat * Math.PI) / 180)];
}

function view(pose) {
  const from = onMap(pose.lat, pose.lon);
  const points = [from];
  for (let k = 0; k <= 16; k++) points.push(away(from, pose.heading_deg + pose.fov_deg * (k / 16 - 0.5), REACH_M));
  return points;
}

function showCandidates() {
  spots.clearLayers();
  const result = standing();
  const candidates = [...(result?.candidates ?? []).entries()].reverse(); // the best is drawn over the others
  for (const [index, { pose, ellipse }] of candidates) {
    const isBest = index === 0 && result.answered;
    drawView(pose, isBest);
    if (ellipse && index === state.chosen) drawEllipse(ellipse);
    drawSpot(pose, index, isBest);
  }
  showLegend();
}

// Explains the marks that are on the map.
function showLegend() {
  const result = standing();
  const candidates = result?.candidates ?? [];
  const interval_m = state.area?.contours_m?.[Math.round(map.getZoom())];
  const shown = {
    camera: state.pose,
    best: result?.answered,
    spots: candidates.length > (result?.answered ? 1 : 0),
    ellipse: candidates[state.chosen]?.ellipse,
    noted: state.photo?.lonlat_deg,
    circle: map.hasLayer(circle),
    names: names.length,
    area: state.area,
    contours: interval_m,
  };
  $("contours").textContent = `contours every ${interval_m} m, darker every ${5 * interval_m} m`;
  for (const item of $("map-legend").children) item.hidden = !shown[item.dataset.of];
}

// Names what is in sight, the highest first, as far as there is room.
function showNames() {
  named.clearLayers();
  const size = map.getSize();
  const taken = [];
  for (const [name, lon, lat] of names) {
    const at = onMap(lat, lon);
    const { x, y } = map.latLngToContainerPoint(at);
    const box = [x - 6, y - 9, x + 12 + 7 * name.length, y + 9];
    if (box[0] < 0 || box[1] < 0 || box[2] > size.x || box[3] > size.y) continue;
    if (taken.some((other) => box[0] < other[2] && other[0] < box[2] && box[1] < other[3] && other[1] < box[3])) continue;
    taken.push(box);
    L.marker(at, { icon: icon("peak", 10), interactive: false, keyboard: false, alt: "", zIndexOffset: -1000 }).addTo(named)
      .bindTooltip(name, { permanent: true, direction: "right", offset: [4, 0], className: "label" });
    if (taken.length === MOST_NAMES) break;
  }
}

async function fetchNames(area) {
  const found = area?.peaks ? await server.names(area).catch(() => []) : [];
  if (area?.id !== state.area?.id) return;
  names = found;
  showNames();
  showLegend();
}

function drawView(pose, isBest) {
  const share = pose.confidence ?? 0.3;
  const color = isBest ? "#d1103d" : "#1f5fbf";
  const opacities = { opacity: 0.4 + 0.6 * share, fillOpacity: 0.06 + 0.22 * share };
  L.polygon(view(pose), { color, weight: 1.5, ...opacities, interactive: false }).addTo(spots);
}

// The ellipse holds the true place with 95 % probability.
function drawEllipse(outline) {
  L.polygon(outline.map(([lon, lat]) => onMap(lat, lon)), { color: "#fff", weight: 1.5, fill: false, interactive: false }).addTo(spots);
}

function drawSpot({ lat, lon, confidence }, index, isBest) {
  const title = `Candidate ${index + 1}${confidence === null ? "" : `: ${percent(confidence)}`}`;
  const kinds = `spot${isBest ? " best" : ""}${index === state.chosen ? " chosen" : ""}`;
  L.marker(onMap(lat, lon), { icon: icon(kinds, 26, String(index + 1)), title, alt: title, zIndexOffset: 1000 - 10 * index })
    .on("click keypress", () => emit("choose", index)).addTo(spots);
}

// The place noted in the photo, with the accuracy that it claims.
function showNoted(photo) {
  noted.clearLayers();
  if (!photo?.lonlat_deg) return;
  const [lon, lat] = photo.lonlat_deg;
  const at = onMap(lat, lon);
  const about = "Place noted in the photo";
  if (photo.accuracy_m) L.circle(at, { radius: photo.accuracy_m, color: "#f2a7ff", weight: 1.5, fillOpacity: 0.08, interactive: false }).addTo(noted);
  L.marker(at, { icon: icon("noted", 16), title: about, alt: about, keyboard: false, zIndexOffset: 500 }).addTo(noted)
    .bindTooltip("GPS", { permanent: true, direction: "right", offset: [8, 0], className: "label" });
}

// Shows the answer and its view; without an answer, all candidates.
function goToResult() {
  const result = standing();
  const shown = result?.answered ? result.candidates.slice(0, 1) : result?.candidates ?? [];
  if (shown.length) map.fitBounds(L.latLngBounds(shown.flatMap(({ pose }) => view(pose))).pad(0.1), { maxZoom: 15, animate: false, paddingTopLeft: [50, 0] });
}

function showCamera() {
  const { pose } = state;
  for (const layer of [camera, handle, cone]) pose ? layer.addTo(map) : layer.remove();
  if (!pose) return;
  camera.setLatLng(onMap(pose.lat, pose.lon));
  handle.setLatLng(map.containerPointToLatLng(handlePoint(pose)));
  cone.setLatLngs(view(pose));
}

// Where the handle stands on the screen: where it covers no candidate's number.
function handlePoint(pose) {
  const point = (layer) => map.latLngToContainerPoint(layer.getLatLng());
  const turn = (pose.heading_deg * Math.PI) / 180;
  const ends = HANDLE_PX.map((px) => point(camera).add([px * Math.sin(turn), -px * Math.cos(turn)]));
  const numbers = spots.getLayers().filter((one) => one.getLatLng).map(point);
  return ends.find((end) => numbers.every((one) => one.distanceTo(end) > APART_PX)) ?? ends[0];
}

function turning() {
  const from = map.latLngToContainerPoint(camera.getLatLng());
  const to = map.latLngToContainerPoint(handle.getLatLng());
  const heading_deg = (Math.atan2(to.x - from.x, from.y - to.y) * 180) / Math.PI;
  moveTo({ heading_deg: (heading_deg + 360) % 360 }, true);
}

function keys(marker, moved) {
  marker.on("add", () => {
    const node = marker.getElement();
    if (node.dataset.keys) return;
    node.dataset.keys = "yes";
    node.addEventListener("keydown", (event) => {
      const step = ARROWS[event.key];
      if (!step) return;
      event.preventDefault();
      event.stopPropagation();
      moved(step.map((one) => one * (event.shiftKey ? 20 : 2)));
    });
  });
}

function nudged(marker, by) {
  return offMap(map.containerPointToLatLng(map.latLngToContainerPoint(marker.getLatLng()).add(by)));
}

function makeCamera() {
  camera = L.marker([0, 0], { icon: icon("camera", 44), draggable: true, zIndexOffset: 3000, autoPan: true,
    title: "The camera: drag it, or move it with the arrow keys", alt: "The camera" });
  handle = L.marker([0, 0], { icon: icon("turn", 20), draggable: true, zIndexOffset: 3000,
    title: "Where it looks: drag it, or use the left and right arrow keys", alt: "Where the camera looks" });
  cone = L.polygon([], { color: "#35d0ff", weight: 2, fillOpacity: 0.15, interactive: false });
  camera.on("drag", () => moveTo(offMap(camera.getLatLng()), true));
  handle.on("drag", turning);
  for (const marker of [camera, handle]) marker.on("dragend", release);
  keys(camera, (by) => moveTo(nudged(camera, by)));
  keys(handle, ([across]) => moveTo({ heading_deg: (state.pose.heading_deg + across / 2 + 360) % 360 }));
}

// Draws the circle that limits the search, unless its radius is null.
function drawCircle(km) {
  state.circle ??= middle();
  if (km !== null) circle.setRadius(1000 * km);
  for (const one of [circle, centre]) {
    one.setLatLng(onMap(state.circle.lat, state.circle.lon));
    km === null ? one.remove() : one.addTo(map);
  }
  showLegend();
  // Without an area, the circle is all that the map shows.
  if (km !== null && !state.area) map.fitBounds(circle.getBounds(), { animate: false });
}

export const middle = () => offMap(map.getCenter());

function makeCircle() {
  const place = map.getCenter();
  circle = L.circle(place, { radius: 3000, color: "#ff9f6b", weight: 2, dashArray: "6 4", fillOpacity: 0.05, interactive: false });
  centre = L.marker(place, { icon: icon("centre", 18), draggable: true, title: "Middle of the circle: drag it, or use the arrow keys", alt: "Middle of the circle" });
  const moved = () => {
    circle.setLatLng(centre.getLatLng());
    state.circle = offMap(centre.getLatLng());
    emit("circled");
  };
  centre.on("drag", moved);
  keys(centre, (by) => {
    const at = nudged(centre, by);
    centre.setLatLng(onMap(at.lat, at.lon));
    moved();
  });
}

function showWhere() {
  let asked = 0;
  const where = element("div", { class: "where" });
  const control = L.control({ position: "bottomright" });
  control.onAdd = () => where;
  control.addTo(map);
  const at = (shown) => {
    const place = offMap(shown);
    where.textContent = degrees(place.lon, place.lat);
    server.send({ type: "height", ...place, area: state.area?.id, seq: ++asked });
  };
  map.on("mousemove", (event) => at(event.latlng));
  map.on("moveend", () => at(map.getCenter()));
  at(map.getCenter());
  on("connected", () => at(map.getCenter()));
  on("height", ({ height_m, seq }) => {
    if (seq === asked && Number.isFinite(height_m)) where.textContent += `  ${Math.round(height_m)} m`;
  });
}

const eastOf = (west, east) => (east < west ? east + 360 : east);
const box = ([west, south, east, north]) => L.latLngBounds([south, west], [north, eastOf(west, east)]);

function makeMap() {
  map = L.map("map", { attributionControl: false, maxZoom: 18, minZoom: 1, zoomSnap: 0.5 }).setView([0, 0], 1);
  L.control.scale({ imperial: false }).addTo(map);
  frame = L.layerGroup().addTo(map);
  map.on("moveend", () => state.area || showDegrees());
  map.on("click", ({ latlng }) => state.area || searchAround(offMap(latlng)));
  named = L.layerGroup().addTo(map);
  noted = L.layerGroup().addTo(map);
  spots = L.layerGroup().addTo(map);
}

// Shows the relief and the outline of the stores that are searched.
function showArea(area) {
  relief?.remove();
  relief = null;
  frame.clearLayers();
  if (!area) return showDegrees();
  const { bounds, terrain } = area;
  const [west, , east] = bounds;
  middleLon = (west + eastOf(west, east)) / 2;
  if (terrain) addRelief(area);
  else alertUser("The store's DEM is not at hand: the page shows no relief and renders no skyline. Start skyline serve with --dem DEM.", "dem");
  L.rectangle(box(bounds), { color: "#fff", weight: 1.5, dashArray: "2 5", fill: false, interactive: false }).addTo(frame);
  map.fitBounds(box(bounds), { padding: [8, 8], animate: false });
  if (!map.hasLayer(circle)) state.circle = middle();
}

// Draws and names lines of latitude and longitude, as many as have room for their names.
function showDegrees() {
  frame.clearLayers();
  const size = map.getSize();
  const seen = map.getBounds();
  const [west, south, east, north] = [seen.getWest(), seen.getSouth(), seen.getEast(), seen.getNorth()];
  const line = (from, to, name, offset) => L.polyline([from, to], { color: "#79838c", weight: 1, interactive: false })
    .bindTooltip(name, { permanent: true, direction: "right", offset, className: "degrees" }).addTo(frame).openTooltip(from);
  for (const lat of linesBetween(Math.max(-80, south), Math.min(80, north), size.y / NAME_PX[1])) {
    line([lat, west], [lat, east], degreesOf(lat, "N", "S"), [0, 0]);
  }
  for (const lon of linesBetween(west, east, size.x / NAME_PX[0])) {
    line([north, lon], [south, lon], degreesOf(offMap({ lat: 0, lng: lon }).lon, "E", "W"), [0, 10]);
  }
}

function linesBetween(from, to, most) {
  const step = STEPS_DEG.find((one) => to - from <= most * one) ?? STEPS_DEG.at(-1);
  const first = Math.ceil(from / step);
  return Array.from({ length: Math.max(0, Math.floor(to / step) - first + 1) }, (_, k) => (first + k) * step);
}

const degreesOf = (value, above, below) => `${Number(Math.abs(value).toFixed(2))}° ${value < 0 ? below : above}`;

function addRelief({ id, terrain }) {
  // Leaflet compares tiles with bounds within one turn only.
  const noWrap = terrain[0] < terrain[2];
  const bounds = noWrap ? box(terrain) : undefined;
  relief = L.tileLayer(`relief/${id}/{z}/{x}/{y}.png`, { bounds, maxZoom: 18, noWrap, zIndex: 0 }).addTo(map);
}

// On a phone one finger scrolls the page, and two move the map.
function takeFingers() {
  map.dragging[isPhone() ? "disable" : "enable"]();
}

export function start() {
  makeMap();
  takeFingers();
  onPhone(takeFingers);
  makeCamera();
  makeCircle();
  showWhere();
  map.on("zoomend viewreset moveend", showCamera);
  map.on("moveend resize", showNames);
  map.on("zoomend", showLegend);
  $("near-here").onclick = () => searchAround(middle());
  $("place-here").onclick = () => placeAt(middle());
  new ResizeObserver(() => map.invalidateSize()).observe($("map"));
  showArea(null);
  on("area", showArea);
  on("area", fetchNames);
  on("pose", () => {
    showCamera();
    showLegend();
  });
  on("circle", drawCircle);
  for (const name of ["photo", "result", "chosen", "left", "known", "skyline"]) on(name, showCandidates);
  on("photo", showNoted);
  on("result", goToResult);
  on("chosen", () => {
    const at = state.pose && onMap(state.pose.lat, state.pose.lon);
    if (at && !map.getBounds().pad(-0.1).contains(at)) map.panTo(at, { animate: false });
  });
}

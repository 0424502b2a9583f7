// Saving results as files.
import * as server from "./server.js";
import { standing } from "./known.js";
import { waits } from "./brush.js";
import { saved } from "./kept.js";
import { $, element, on, report, settle, showStatus, state } from "./state.js";

const KINDS = [
  ["photo", "-located.jpg", "Photo with place", "A copy of the photo with position and direction in its EXIF"],
  ["names", "-names.png", "Names", "The photo with the names and distances of the summits in it"],
  ["report", "-report.html", "Report", "One page with pictures and maps"],
  ["geojson", ".geojson", "GeoJSON", "Candidates, views and ellipses"],
  ["kml", ".kml", "KML", "The photo stands in the landscape; keep the photo beside the file"],
  ["kmz", ".kmz", "KMZ", "The same with the photo inside"],
  ["gpx", ".gpx", "GPX", "A waypoint for a navigation device"],
];

async function save(kind, ending, button) {
  const photo = state.photo;
  button.disabled = true;
  settle("save");
  showStatus("Writing…");
  try {
    download(photo, await server.save(photo, kind, toSave()), ending);
    showStatus("Saved");
  } catch (error) {
    showStatus("");
    report(error, "save");
  }
  show();
}

// The request for the pose to save: a candidate has its verdict as long as that stands.
function toSave() {
  const isCurrent = state.chosen === null || standing();
  if (isCurrent && state.origin === "fitted") return { fitted: true };
  if (isCurrent && state.origin === "found") return { rank: state.chosen };
  return { pose: state.pose };
}

// The page has the skyline's file, so it is saved without the server.
function saveTrace() {
  const { photo } = state;
  download(photo, new Blob([state.trace], { type: "text/csv" }), ".csv");
  if (waits(photo)) return showStatus("Saved without the last strokes, which wait for the server");
  saved(photo);
  showStatus("Saved");
}

function download(photo, blob, ending) {
  const stem = photo.name.replace(/\.[^.]*$/, "");
  const link = element("a", { download: stem + ending, href: URL.createObjectURL(blob) });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

function show() {
  for (const [kind] of KINDS) $(`save-${kind}`).disabled = !state.photo || !state.pose;
  $("save-names").hidden = !state.area?.peaks;
  $("save-trace").disabled = !state.trace;
  $("load-trace").disabled = !state.photo;
  const unsaved = state.photos.filter((photo) => photo.unsaved).map((photo) => photo.name);
  $("unsaved").textContent = unsaved.length ? `Not saved: the mended skyline of ${unsaved.join(", ")}. “Trace” saves it.` : "";
}

export function start() {
  for (const [kind, ending, label, about] of KINDS) {
    const button = element("button", { id: `save-${kind}`, title: about, onclick: () => save(kind, ending, button) }, label);
    $("save-trace").before(button);
  }
  $("save-trace").onclick = saveTrace;
  for (const name of ["photo", "pose", "skyline", "area", "unsaved"]) on(name, show);
  on("photo", () => settle("save"));
  show();
}

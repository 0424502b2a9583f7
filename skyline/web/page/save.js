// Saving results as files.
import * as server from "./server.js";
import { standing } from "./known.js";
import { $, alertUser, element, on, showStatus, state } from "./state.js";

const KINDS = [
  ["photo", "-located.jpg", "Photo with place", "A copy of the photo with position and direction in its EXIF"],
  ["names", "-names.png", "Names", "The photo with the names and distances of the summits in it"],
  ["report", "-report.html", "Report", "One page with pictures and maps"],
  ["geojson", ".geojson", "GeoJSON", "Candidates, views and ellipses"],
  ["kml", ".kml", "KML", "The photo stands in the landscape; keep the photo beside the file"],
  ["kmz", ".kmz", "KMZ", "The same with the photo inside"],
  ["gpx", ".gpx", "GPX", "A waypoint for a navigation device"],
  ["trace", ".csv", "Trace", "The skyline as it is now, to load again"],
];

async function save(kind, ending, button) {
  const photo = state.photo;
  button.disabled = true;
  showStatus("Writing…");
  try {
    const isFound = state.origin === "found" && standing();
    const chosen = isFound ? { rank: state.chosen } : state.origin === "fitted" ? { fitted: true } : { pose: state.pose };
    const blob = await server.save(photo, kind, chosen);
    const stem = photo.name.replace(/\.[^.]*$/, "");
    const link = element("a", { download: stem + ending, href: URL.createObjectURL(blob) });
    document.body.append(link);
    link.click();
    link.remove();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
    showStatus("Saved");
  } catch (error) {
    showStatus("");
    alertUser(error.message);
  }
  show();
}

const offered = () => KINDS.filter(([kind]) => kind !== "names" || state.store.peaks);

function show() {
  for (const [kind] of offered()) $(`save-${kind}`).disabled = !state.photo || (kind !== "trace" && !state.pose);
  $("load-trace").disabled = !state.photo;
}

export function start() {
  for (const [kind, ending, label, about] of offered()) {
    const button = element("button", { id: `save-${kind}`, title: about, onclick: () => save(kind, ending, button) }, label);
    $("load-trace").before(button);
  }
  for (const name of ["photo", "pose"]) on(name, show);
  show();
}

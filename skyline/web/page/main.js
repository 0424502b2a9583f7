// Starts the parts of the page.
import * as brush from "./brush.js";
import * as find from "./find.js";
import * as hand from "./hand.js";
import * as kept from "./kept.js";
import * as known from "./known.js";
import * as map from "./map.js";
import * as photos from "./photos.js";
import * as saving from "./save.js";
import * as server from "./server.js";
import { $, on, report, setArea, state } from "./state.js";
import * as touch from "./touch.js";
import * as view from "./view.js";

try {
  state.server = await server.about();
  on("area", (area) => ($("store").textContent = area ? `${area.store}: ${area.places} places` : ""));
  const where = state.server.machine
    ? `Photos go to ${state.server.machine}, the machine that serves this page, and to no other. Over a network they are sent unencrypted.`
    : "Photos stay on this machine.";
  $("privacy").textContent = state.server.area ? where : `${where} The elevation of the area is fetched when you find the place.`;
  const opened = await server.begin(photos.restore);
  for (const part of [kept, view, touch, hand, map, known, find, saving, brush]) part.start();
  setArea(state.server.area);
  document.documentElement.dataset.ready = "yes";
  await photos.start(opened);
} catch (error) {
  report(error, "start");
}

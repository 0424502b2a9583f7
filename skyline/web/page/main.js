// Starts the parts of the page.
import * as brush from "./brush.js";
import * as find from "./find.js";
import * as hand from "./hand.js";
import * as known from "./known.js";
import * as map from "./map.js";
import * as photos from "./photos.js";
import * as saving from "./save.js";
import * as server from "./server.js";
import { $, alertUser, state } from "./state.js";
import * as view from "./view.js";

try {
  state.store = await server.about();
  $("store").textContent = `${state.store.store}: ${state.store.places} places`;
  const kept = await server.begin();
  for (const part of [view, hand, map, known, find, saving, brush]) part.start();
  document.documentElement.dataset.ready = "yes";
  await photos.start(kept);
} catch (error) {
  alertUser(error.message);
}

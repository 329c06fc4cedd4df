// SPDX-License-Identifier: MIT
// The points of a cell of the confusion matrix, in the scan with most of them.

import { byId, cellWords, data } from "./data.js";
import { choose } from "./scans.js";
import { showEverything, state } from "./state.js";

export async function showCell(key) {  // `key`: train ids of truth and label, such as "9,11"
  const [shown, most] = data.cells[key];
  const [truth, label] = key.split(",").map(Number);
  const words = cellWords({ truth, label });
  if (shown < 0) {
    byId("cell").textContent = `No scan of this page has ${words}. Most are in ${most}: run report with --scans ${most}.`;
    return;
  }
  byId("cell").textContent = `${data.shown[shown].name} has most ${words} of the scans of this page.`;
  showEverything();
  state.cell = { truth, label };
  await choose(shown);
  byId("scans").scrollIntoView({ behavior: "smooth" });
}

// SPDX-License-Identifier: MIT
// The address of the page, which contains the state, for links:
// #scan=08/000000&colour=error&beside=truth&by=error&above=0.3&size=2&hide=road,car&boxes=no&truth=road&taken=parking&tag=08/000000.

import { byId, data, TOP } from "./data.js";
import { valueOf } from "./scales.js";
import { besides, page, showEverything, state } from "./state.js";

const PAUSE_MS = 150;  // browsers refuse many changes at once
let saving = 0;

export function save() {  // the state in the address, after a pause
  clearTimeout(saving);
  if (!page.cloud || page.playing) return;
  saving = setTimeout(() => history.replaceState(null, "", `#${address()}`), PAUSE_MS);
}

function address() {
  const { hidden, cell } = state;
  const parts = { scan: page.cloud.name, colour: state.colour, beside: besides() };
  if (state.by && state.above < TOP) {
    parts.by = state.by;
    parts.above = +valueOf(state.by, state.above).toPrecision(3);
  }
  if (state.size !== 2) parts.size = state.size;
  if (hidden.label.size) parts.hide = [...hidden.label].map(id => data.classes[id].name).join(",");
  if (!state.boxes) parts.boxes = "no";
  if (cell) {
    parts.truth = data.classes[cell.truth].name;
    parts.taken = data.classes[cell.label].name;
  }
  const linked = new URLSearchParams(parts);
  page.table.list().forEach(name => linked.append("tag", name));
  return linked;
}

export function load() {  // the state from the address; return the index of its scan, 0 without one
  const linked = new URLSearchParams(location.hash.slice(1));
  showEverything();
  state.colour = linked.get("colour") ?? state.colour;
  state.beside = linked.get("beside") ?? state.beside;
  state.by = linked.get("by") ?? state.by;
  state.threshold = linked.has("above") ? +linked.get("above") : null;
  state.size = +linked.get("size") || 2;
  state.boxes = linked.get("boxes") !== "no";
  state.cell = cellOf(linked);
  const names = (linked.get("hide") ?? "").split(",");
  data.classes.forEach(({ name }, id) => {
    if (names.includes(name)) state.hidden.label.add(id);
  });
  page.table.tags = new Set(linked.getAll("tag").filter(name => data.drive.names.includes(name)));
  page.table.draw();
  byId("boxes").checked = state.boxes;
  byId("size").value = state.size;
  if (page.view) page.view.size = state.size;
  return Math.max(0, data.shown.findIndex(({ name }) => name === linked.get("scan")));
}

function cellOf(linked) {  // of the confusion matrix; null without one
  const idOf = key => data.classes.findIndex(({ name }) => name === linked.get(key));
  const cell = { truth: idOf("truth"), label: idOf("taken") };
  return cell.truth >= 0 && cell.label >= 0 ? cell : null;
}

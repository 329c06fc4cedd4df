// SPDX-License-Identifier: MIT
// What the user has chosen, and the parts of the page.

import { data, TOP } from "./data.js";

export const state = {  // what a link to the page contains
  scan: 0,
  colour: "",
  beside: data.occurring.truth.length ? "truth" : "",  // colour of the second pane
  by: "",  // value by which points are hidden
  above: TOP,  // byte of that value above which points are hidden
  threshold: null,  // the same as a number, from a link, until a scan with its scale is shown
  size: 2,
  boxes: true,
  cell: null,  // of the confusion matrix: train ids of truth and label
  hidden: { label: new Set(), truth: new Set(), wrong: new Set() },
};

export const page = {
  cloud: null,  // points of the scan
  visible: null,  // per point: 0 hidden, 1 shown, 2 faint
  playing: false,
  view: null,  // PointView; null without WebGL 2
  drive: null,  // DriveView
  table: null,  // ScanTable
};

export function besides() {  // the colour of the second pane; empty for none
  const { cloud } = page;
  return cloud.values[state.beside] && state.beside !== state.colour ? state.beside : "";
}

export function showEverything() {  // no class, value or cell hides points
  Object.values(state.hidden).forEach(ids => ids.clear());
  state.above = TOP;
  state.cell = null;
}

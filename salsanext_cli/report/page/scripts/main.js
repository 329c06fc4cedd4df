// SPDX-License-Identifier: MIT
// Start of the page, and its controls.

import { load, save } from "./address.js";
import { showCell } from "./confusions.js";
import { byId, data, floats } from "./data.js";
import { DriveView } from "./drive.js";
import { describe, filter, options, paint, refilter } from "./points.js";
import { pointAt, rangeImages } from "./range_images.js";
import { choose, play, stop } from "./scans.js";
import { page, showEverything, state } from "./state.js";
import { MORE_ROWS, ScanTable } from "./table.js";
import { PointView, steer } from "./view.js";

const ARRAYS = ["shares", "uncertainty", "wrong", "doubtful", "rejected"];  // of `data.drive`: numbers of the scans

function scansOfDrive() {
  const scans = { ...data.drive };
  scans.count = scans.names.length;
  scans.marked = scans.shown.map(i => i >= 0 && data.shown[i].reason);
  for (const name of ARRAYS) scans[name] = floats(scans[name]);
  return scans;
}

function open(index) {
  choose(index);
  byId("scans").scrollIntoView({ behavior: "smooth" });
}

function tagged() {  // after a change of the tags
  const { cloud, table } = page;
  if (cloud) byId("tag").checked = table.tags.has(cloud.name);
  save();
}

function repaint() {  // after a change of the panes
  const { cloud, view } = page;
  if (!cloud) return;
  const panes = view?.panes.length;
  paint();
  if (view && view.panes.length !== panes) view.home();
}

function on(id, name, change) {
  const control = byId(id);
  control.addEventListener(name, () => change(control.value));
}

function listenToChoiceOfScan() {
  on("scan", "change", value => choose(+value));
  on("place", "input", value => choose(+value));
  on("play", "click", () => page.playing ? stop() : play());
  addEventListener("hashchange", () => location.hash.includes("scan=") && choose(load()));
}

function listenToColours() {
  on("colour", "change", value => {
    state.colour = value;
    repaint();
  });
  on("beside", "change", value => {
    state.beside = value;
    repaint();
  });
  on("size", "input", value => {
    state.size = +value;
    if (!page.view) return;
    page.view.size = +value;
    page.view.redraw();
  });
  on("size", "change", save);
}

function listenToFilters() {
  on("by", "change", value => {
    state.by = value;
    refilter();
  });
  on("above", "input", value => {
    state.above = +value;
    refilter();
  });
  on("boxes", "change", () => {
    state.boxes = byId("boxes").checked;
    filter();
    save();
  });
  on("home", "click", () => page.view?.home());
  on("all", "click", () => {
    showEverything();
    filter();
    paint();
  });
  byId("confusion")?.addEventListener("click", event => {
    const { cell } = event.target.dataset;
    if (cell) showCell(cell);
  });
}

function listenToTable() {
  const { table } = page;
  on("tag", "change", () => page.cloud && table.tag(page.cloud.name, byId("tag").checked));
  on("save", "click", () => table.save());
  on("more", "click", () => table.showMore(MORE_ROWS));
}

function listenToFullScreen() {
  const button = byId("full");
  button.hidden = !document.fullscreenEnabled;
  button.addEventListener("click", () => {
    if (document.fullscreenElement) document.exitFullscreen();
    else byId("stage").requestFullscreen();
  });
  document.addEventListener("fullscreenchange", () => {
    button.textContent = document.fullscreenElement ? "leave full screen" : "full screen";
  });
}

function listenToRangeImages() {
  for (const canvas of rangeImages()) {
    canvas.addEventListener("pointermove", event => page.cloud && describe(pointAt(canvas, event)));
    canvas.addEventListener("pointerleave", () => describe(-1));
  }
}

function startView() {  // without WebGL 2, the rest of the page works
  try {
    page.view = new PointView(byId("cloud"));
  } catch (error) {
    byId("hint").style.display = "block";
    byId("hint").textContent = `Cannot show points: ${error.message}.`;
    return;
  }
  let pointer = null;  // one search for a point per frame
  steer(page.view, position => {
    const isWaiting = pointer !== null;
    pointer = { position };
    if (isWaiting) return;
    requestAnimationFrame(() => {
      const { position: last } = pointer;
      pointer = null;
      describe(last ? page.view.pick(last.x, last.y) : -1);
    });
  });
}

function start() {
  options(byId("scan"), [...data.shown.keys()], i => [data.shown[i].name, data.shown[i].reason].filter(Boolean).join(" · "));
  byId("place").max = data.shown.length - 1;
  byId("boxes").closest("label").hidden = !data.boxes;
  byId("through").hidden = data.shown.length < 2;
  for (const entry of data.classes) entry.css = `rgb(${entry.rgb})`;
  const scans = scansOfDrive();
  const drive = new DriveView(byId("columns"), byId("column"), scans, data.classes, open);
  page.drive = drive;
  page.table = new ScanTable(byId("table"), scans, { open, changed: tagged, largest: place => drive.largest(place) });
  startView();
  listenToChoiceOfScan();
  listenToColours();
  listenToFilters();
  listenToTable();
  listenToFullScreen();
  listenToRangeImages();
  choose(load()).then(() => { document.documentElement.dataset.ready = "yes"; });
}

start();

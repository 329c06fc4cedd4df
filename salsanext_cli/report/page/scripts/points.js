// SPDX-License-Identifier: MIT
// The points of a scan: their colours, which of them are visible, and the description of one.

import { save } from "./address.js";
import { byId, CATEGORIES, cellWords, data, JUDGED, NO_VALUE, paletteOf, percentOf, title, TITLES, TOP, WRONG } from "./data.js";
import { drawLegend } from "./legend.js";
import { drawRangeImages, markInRangeImages } from "./range_images.js";
import { drawScale, shownValue, valueOf } from "./scales.js";
import { besides, page, state } from "./state.js";

const NAME_WIDTH = 21;  // characters of a name in the description of a point

export function options(select, names, text) {  // replacing equal options would close an open list
  if ([...select.options].map(option => option.value).join() === names.join()) return;
  select.replaceChildren(...names.map(name => new Option(text(name), name)));
}

export function show(index, cloud) {
  const isFirst = !page.cloud;
  state.scan = index;
  page.cloud = cloud;
  setMenus();
  applyThreshold();
  byId("tag").checked = page.table.tags.has(cloud.name);
  page.view?.show(cloud);
  page.drive.point(data.drive.shown.indexOf(index));
  describe(-1);
  filter();
  paint();
  if (isFirst) page.view?.home();
}

function setMenus() {  // the values of this scan
  const names = Object.keys(page.cloud.values);
  const uncertain = names.filter(name => data.uncertain.includes(name));
  if (!names.includes(state.colour)) state.colour = names[0];
  if (!uncertain.includes(state.by)) state.by = uncertain[0] ?? "";
  options(byId("colour"), names, title);
  options(byId("beside"), ["", ...names], name => name ? title(name) : "nothing");
  options(byId("by"), uncertain, title);
  byId("colour").value = state.colour;
  byId("beside").value = besides();
  byId("by").value = state.by;
  // Where other scans have uncertainty, the control keeps its place.
  const control = byId("by").closest("label");
  control.hidden = !data.uncertain.some(name => data.scales[name]);
  control.style.visibility = uncertain.length ? "" : "hidden";
}

function applyThreshold() {  // the number of a link as the nearest byte of its scale
  if (state.threshold === null || !data.scales[state.by]) return;
  const far = byte => Math.abs(valueOf(state.by, byte) - state.threshold);
  const all = [...Array(TOP + 1).keys()];
  state.above = all.reduce((best, byte) => far(byte) < far(best) ? byte : best, 0);
  state.threshold = null;
}

export function paint() {  // in the chosen colours
  if (!page.cloud) return;
  const { values } = page.cloud;
  const beside = besides();
  const palettes = [state.colour, "label", beside || state.colour].flatMap(name => [...paletteOf(name)]);
  page.view?.colour(values[state.colour], beside ? values[beside] : null, Uint8Array.from(palettes));
  byId("names").hidden = !beside;
  byId("name").textContent = title(state.colour);
  byId("beside-name").textContent = beside && title(beside);
  drawScale(byId("scale"), state.colour);
  drawScale(byId("beside-scale"), beside);
  drawLegend(refilter);
  drawRangeImages();
  save();
}

export function refilter() {  // after a change of what is hidden
  filter();
  drawRangeImages();
  save();
}

export function filter() {  // by class, by uncertainty and by cell of the confusion matrix
  if (!page.cloud) return;
  const { boxes } = page.cloud;
  page.visible = visiblePoints(page.cloud);
  page.view?.filter(page.visible);
  page.view?.outline(boxes.filter(([id]) => state.boxes && !state.hidden.label.has(id)));
  const marked = +document.documentElement.dataset.point;
  if (marked >= 0 && page.visible[marked] !== 1) describe(-1);
  byId("above").value = state.above;
  byId("above-value").textContent = state.by && state.above < TOP ? shownValue(state.by, state.above) : "all shown";
  summarise();
}

function visiblePoints(cloud) {  // per point: 0 hidden, 1 shown, 2 faint
  const visible = new Uint8Array(cloud.shown).fill(1);
  for (const [name, hidden] of Object.entries(state.hidden)) {
    const ids = cloud.values[name];
    if (hidden.size && ids) hideClasses(visible, ids, hidden);
  }
  const above = cloud.values[state.by];
  if (above && state.above < TOP) hideAbove(visible, above);
  const { label, truth } = cloud.values;
  if (state.cell && label && truth) dimOtherCells(visible, label, truth);
  return visible;
}

function hideClasses(visible, ids, hidden) {
  for (let i = 0; i < visible.length; i++) {
    if (hidden.has(ids[i])) visible[i] = 0;
  }
}

function hideAbove(visible, values) {
  for (let i = 0; i < visible.length; i++) {
    if (values[i] > state.above) visible[i] = 0;
  }
}

function dimOtherCells(visible, label, truth) {
  const { cell } = state;
  for (let i = 0; i < visible.length; i++) {
    const isInCell = label[i] === cell.label && truth[i] === cell.truth;
    if (visible[i] && !isInCell) visible[i] = 2;
  }
}

export function summarise() {  // in words
  if (!page.cloud) return;
  const { shown, points } = page.cloud;
  const counts = countVisible(page.cloud, page.visible);
  const number = count => count.toLocaleString("en");
  const share = (part, whole) => percentOf(whole ? part / whole : NaN);
  let text = points > shown ? `${number(shown)} of ${number(points)} points in this page` : `${number(shown)} points`;
  if (state.cell) text += `, ${number(counts.visible)} of them ${cellWords(state.cell)}`;
  else if (counts.visible < shown) text += `, ${share(counts.visible, shown)} visible`;
  if (counts.judged && !state.cell) {
    const which = counts.visible < shown ? "visible " : "";
    text += `: ${share(counts.visibleWrong, counts.visibleJudged)} of the ${number(counts.visibleJudged)} ${which}${JUDGED} wrong`;
    if (which) text += ` instead of ${share(counts.wrong, counts.judged)}`;
  }
  byId("summary").textContent = text;
  document.documentElement.dataset.shown = counts.visible;
}

function countVisible({ shown, values }, visible) {
  const counts = { visible: 0, judged: 0, wrong: 0, visibleJudged: 0, visibleWrong: 0 };
  for (let i = 0; i < shown; i++) {
    const outcome = values.wrong?.[i] ?? 0;
    const isVisible = +(visible[i] === 1);
    const isWrong = +(outcome === WRONG);
    counts.visible += isVisible;
    if (!outcome) continue;
    counts.judged++;
    counts.wrong += isWrong;
    counts.visibleJudged += isVisible;
    counts.visibleWrong += isVisible * isWrong;
  }
  return counts;
}

export function describe(index) {  // mark and describe a point in 3-D and in the range images; none for -1
  if (!page.cloud) return;
  page.view?.mark(index);
  document.documentElement.dataset.point = index;
  markInRangeImages(index);
  const box = byId("point");
  box.hidden = index < 0;
  if (index < 0) return;
  const lines = Object.entries(page.cloud.values).map(([name, ofPoints]) => lineOf(name, ofPoints[index]));
  const metres = page.view ? page.view.place(index).map(axis => axis.toFixed(2)).join(" ") : "";
  lines.push(["x y z", `${metres} m`]);
  box.textContent = lines.map(([name, text]) => `${name.padEnd(NAME_WIDTH)}${text}`).join("\n");
}

function lineOf(name, byte) {  // name and value of a point in words
  if (CATEGORIES[name]) return [TITLES[name] ?? name, CATEGORIES[name][byte].name];
  if (name !== "least_confidence") return [title(name), shownValue(name, byte)];
  return ["confidence", byte === NO_VALUE ? "none" : (1 - valueOf(name, byte)).toFixed(2)];
}

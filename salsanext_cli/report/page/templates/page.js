// SPDX-License-Identifier: MIT
// State of the page: the scan, its colours, and the visible points.

const byId = id => document.getElementById(id);
const data = JSON.parse(byId("data").textContent);
const NO_VALUE = 255, TOP = 254, WRONG = 2;
const CATEGORIES = { label: data.classes, truth: data.classes, wrong: data.outcomes };
const TITLES = { ...data.titles, wrong: "right or wrong" };
const JUDGED = data.drive.judged;
const title = name => TITLES[name] ?? name.replaceAll("_", " ");
const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
const floats = text => text ? new Float32Array(bytes(text).buffer) : null;
const state = {
  scan: 0, colour: "", beside: data.occurring.truth.length ? "truth" : "", by: "", above: TOP, size: 2, boxes: true, cell: null,
  hidden: { label: new Set(), truth: new Set(), wrong: new Set() },
};
let cloud = null, visible = null, view = null, drive = null, table = null, threshold = null, saving = 0;

function paletteOf(colour) {  // 256 colours of 4 bytes
  const rgba = new Uint8Array(1024).fill(70);
  if (CATEGORIES[colour]) CATEGORIES[colour].forEach(({ rgb }, i) => rgba.set([...rgb, 255], 4 * i));
  else for (let i = 0; i <= TOP; i++) rgba.set([...data.map.slice(3 * i, 3 * i + 3), 255], 4 * i);
  return rgba;
}

function options(select, names, text) {  // replacing equal options would close an open list
  if ([...select.options].map(option => option.value).join() === names.join()) return;
  select.replaceChildren(...names.map(name => new Option(text(name), name)));
}

function show(index, next) {
  const first = !cloud;
  state.scan = index;
  cloud = next;
  const names = Object.keys(cloud.values), uncertain = names.filter(name => data.uncertain.includes(name));
  if (!names.includes(state.colour)) state.colour = names[0];
  if (!uncertain.includes(state.by)) state.by = uncertain[0] ?? "";
  options(byId("colour"), names, title);
  options(byId("beside"), ["", ...names], name => name ? title(name) : "nothing");
  options(byId("by"), uncertain, title);
  const any = data.uncertain.some(name => data.scales[name]);  // in some scan: in others the control is only invisible
  byId("by").closest("label").hidden = !any;
  byId("by").closest("label").style.visibility = uncertain.length ? "" : "hidden";
  const scale = data.scales[state.by];
  if (threshold !== null && scale) {
    const far = byte => Math.abs(valueOf(state.by, byte) - threshold);
    state.above = [...Array(TOP + 1).keys()].reduce((best, byte) => far(byte) < far(best) ? byte : best, 0);
    threshold = null;
  }
  byId("colour").value = state.colour;
  byId("beside").value = besides();
  byId("tag").checked = table.tags.has(cloud.name);
  byId("by").value = state.by;
  view?.show(cloud);
  drive.point(data.drive.shown.indexOf(index));
  point(-1);
  filter();
  paint();
  if (first) view?.home();
}

function besides() {  // the colour of the second pane; empty for none
  return cloud.values[state.beside] && state.beside !== state.colour ? state.beside : "";
}

function paint() {  // in the chosen colours
  if (!cloud) return;
  const beside = besides(), palettes = [state.colour, "label", beside || state.colour].flatMap(name => [...paletteOf(name)]);
  view?.colour(cloud.values[state.colour], beside ? cloud.values[beside] : null, Uint8Array.from(palettes));
  byId("names").hidden = !beside;
  byId("name").textContent = title(state.colour);
  byId("beside-name").textContent = beside && title(beside);
  drawScale(byId("scale"), state.colour);
  drawScale(byId("beside-scale"), beside);
  legend();
  strips();
  save();
}

function filter() {  // by class and by uncertainty
  if (!cloud) return;
  const { values, shown } = cloud, above = values[state.by];
  visible = new Uint8Array(shown).fill(1);
  for (const [name, hidden] of Object.entries(state.hidden)) {
    const ids = values[name];
    if (hidden.size && ids) for (let i = 0; i < shown; i++) if (hidden.has(ids[i])) visible[i] = 0;
  }
  if (above && state.above < TOP) for (let i = 0; i < shown; i++) if (above[i] > state.above) visible[i] = 0;
  const { label, truth } = values, { cell } = state;
  if (cell && label && truth) for (let i = 0; i < shown; i++) if (visible[i] && (label[i] !== cell.label || truth[i] !== cell.truth)) visible[i] = 2;
  view?.filter(visible);
  view?.outline(cloud.boxes.filter(([id]) => state.boxes && !state.hidden.label.has(id)));
  const marked = +document.documentElement.dataset.point;
  if (marked >= 0 && visible[marked] !== 1) point(-1);
  byId("above").value = state.above;
  byId("above-value").textContent = state.by && state.above < TOP ? shownValue(state.by, state.above) : "all shown";
  summarise();
}

function summarise() {  // in words
  if (!cloud) return;
  const { values, shown, points } = cloud;
  let seen = 0, judged = 0, wrong = 0, judgedSeen = 0, wrongSeen = 0;
  for (let i = 0; i < shown; i++) {
    const outcome = values.wrong?.[i] ?? 0, is = +(visible[i] === 1);
    seen += is;
    if (!outcome) continue;
    judged++;
    judgedSeen += is;
    if (outcome === WRONG) { wrong++; wrongSeen += is; }
  }
  const number = count => count.toLocaleString("en"), percent = (part, whole) => whole ? `${(100 * part / whole).toFixed(1)} %` : "–";
  const count = points > shown ? `${number(shown)} of ${number(points)} points in this page` : `${number(shown)} points`;
  let text = count;
  if (state.cell) text += `, ${number(seen)} of them ${cellWords(state.cell)}`;
  else if (seen < shown) text += `, ${percent(seen, shown)} visible`;
  if (judged && !state.cell) {
    text += `: ${percent(wrongSeen, judgedSeen)} of the ${number(judgedSeen)} ${seen < shown ? "visible " : ""}${JUDGED} wrong`;
    if (seen < shown) text += ` instead of ${percent(wrong, judged)}`;
  }
  byId("summary").textContent = text;
  document.documentElement.dataset.shown = seen;
}

function strips() {  // the range images: the nearest point of every pixel
  if (!cloud) return;
  const beside = besides();
  strip(byId("strip"), state.colour);
  byId("beside-strip").hidden = !beside;
  if (beside) strip(byId("beside-strip"), beside);
}

function strip(canvas, colour) {
  const { width, height, first, values } = cloud, ids = values[colour], palette = paletteOf(colour);
  const tall = Math.max(1, Math.round(width / height / 10));  // rows are drawn higher than wide
  Object.assign(canvas, { width, height });
  canvas.style.aspectRatio = `${width} / ${height * tall}`;
  const pen = canvas.getContext("2d"), image = pen.createImageData(width, height);
  for (let pixel = 0; pixel < width * height; pixel++) {
    const at = first[pixel], seen = at < first[pixel + 1] ? visible[at] : 0;
    image.data.set(seen === 1 ? palette.subarray(4 * ids[at], 4 * ids[at] + 3) : seen ? [59, 64, 71] : [24, 27, 33], 4 * pixel);
    image.data[4 * pixel + 3] = 255;
  }
  pen.putImageData(image, 0, 0);
  canvas.image = image;
}

function pixelOf(index) {  // -1 for a point without a pixel
  const { first } = cloud;
  if (index < 0 || index >= first[first.length - 1]) return -1;
  let low = 0, high = first.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (first[middle] <= index) low = middle;
    else high = middle;
  }
  return low;
}

function point(index) {  // mark and describe a point in 3-D and in the range image
  if (!cloud) return;
  view?.mark(index);
  const box = byId("point"), { values, width } = cloud;
  box.hidden = index < 0;
  document.documentElement.dataset.point = index;
  for (const canvas of [byId("strip"), byId("beside-strip")]) {
    if (!canvas.image || canvas.hidden) continue;
    const pen = canvas.getContext("2d"), pixel = pixelOf(index);
    pen.putImageData(canvas.image, 0, 0);
    const column = pixel % width, row = Math.floor(pixel / width);
    pen.strokeStyle = "#fff";
    if (pixel >= 0) pen.strokeRect(column - 3.5, row - 1.5, 8, 4);
  }
  if (index < 0) return;
  const lines = Object.entries(values).map(([name, ofPoints]) => {
    const byte = ofPoints[index];
    if (CATEGORIES[name]) return [TITLES[name] ?? name, CATEGORIES[name][byte].name];
    if (name !== "least_confidence") return [title(name), shownValue(name, byte)];
    return ["confidence", byte === NO_VALUE ? "none" : (1 - valueOf(name, byte)).toFixed(2)];
  });
  const metres = view ? view.place(index).map(axis => axis.toFixed(2)).join(" ") : "";
  lines.push(["x y z", `${metres} m`]);
  box.textContent = lines.map(([name, text]) => `${name.padEnd(21)}${text}`).join("\n");
}

// SPDX-License-Identifier: MIT
// State of the page: the scan, its colours, and the visible points. The address contains the state, for links:
// #scan=08/000000&colour=error&by=error&above=0.3&size=2&hide=road,car&boxes=no.

const byId = id => document.getElementById(id);
const data = JSON.parse(byId("data").textContent);
const NO_VALUE = 255, TOP = 254, WRONG = 2;
const CATEGORIES = { label: data.classes, truth: data.classes, wrong: data.outcomes };
const TITLES = { wrong: "right or wrong", error: "probability of error", least_confidence: "1 − confidence" };
const title = name => TITLES[name] ?? name.replaceAll("_", " ");
const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
const floats = text => text ? new Float32Array(bytes(text).buffer) : null;
const state = { scan: 0, colour: "", by: "", above: TOP, size: 2, boxes: true, hidden: { label: new Set(), truth: new Set(), wrong: new Set() } };
let cloud = null, palette = null, visible = null, view = null, drive = null, threshold = null, saving = 0;

function valueOf(name, byte) {  // in the unit of the scale
  const { marks } = data.scales[name], place = byte / TOP * (marks.length - 1), i = Math.min(Math.floor(place), marks.length - 2);
  return marks[i] + (marks[i + 1] - marks[i]) * (place - i);
}

function shownValue(name, byte) {
  if (byte === NO_VALUE) return "none";
  const beyond = byte === TOP && name !== "error" && name !== "least_confidence" ? "≥ " : "";
  return `${beyond}${+valueOf(name, byte).toPrecision(3)} ${data.scales[name].unit}`.trim();
}

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
  state.scan = index;
  cloud = next;
  const names = Object.keys(cloud.values), uncertain = names.filter(name => data.uncertain.includes(name));
  if (!names.includes(state.colour)) state.colour = names[0];
  if (!uncertain.includes(state.by)) state.by = uncertain[0] ?? "";
  options(byId("colour"), names, title);
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
  byId("by").value = state.by;
  view?.show(cloud);
  drive.point(data.drive.shown.indexOf(index));
  point(-1);
  filter();
  paint();
}

function paint() {  // in the chosen colours
  if (!cloud) return;
  palette = paletteOf(state.colour);
  view?.colour(cloud.values[state.colour], Uint8Array.of(...palette, ...paletteOf("label")));
  const scale = data.scales[state.colour];
  byId("scale").hidden = !scale;
  if (scale) {
    byId("low").textContent = shownValue(state.colour, 0);
    const between = scale.marks.slice(1, -1).join(" ");
    byId("high").textContent = shownValue(state.colour, TOP) + (between && ` (in equal steps from 0: ${between})`);
    const pen = byId("gradient").getContext("2d"), image = pen.createImageData(TOP + 1, 1);
    image.data.set(palette.subarray(0, 4 * (TOP + 1)));
    pen.putImageData(image, 0, 0);
  }
  legend();
  strip();
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
  view?.filter(visible);
  view?.outline(cloud.boxes.filter(([id]) => state.boxes && !state.hidden.label.has(id)));
  const marked = +document.documentElement.dataset.point;
  if (marked >= 0 && !visible[marked]) point(-1);
  byId("above").value = state.above;
  byId("above-value").textContent = state.by && state.above < TOP ? shownValue(state.by, state.above) : "all shown";
  summarise();
}

function summarise() {  // in words
  if (!cloud) return;
  const { values, shown, points } = cloud;
  let seen = 0, judged = 0, wrong = 0, judgedSeen = 0, wrongSeen = 0;
  for (let i = 0; i < shown; i++) {
    const outcome = values.wrong?.[i] ?? 0, is = visible[i];
    seen += is;
    if (!outcome) continue;
    judged++;
    judgedSeen += is;
    if (outcome === WRONG) { wrong++; wrongSeen += is; }
  }
  const percent = (part, whole) => whole ? `${(100 * part / whole).toFixed(1)} %` : "–";
  const count = points > shown ? `${shown.toLocaleString("en")} of ${points.toLocaleString("en")} points in this page` : `${shown.toLocaleString("en")} points`;
  let text = seen === shown ? count : `${count}, ${percent(seen, shown)} visible`;
  if (judged) text += `: ${percent(wrongSeen, judgedSeen)} wrong` + (seen === shown ? "" : ` instead of ${percent(wrong, judged)}`);
  byId("summary").textContent = text;
  document.documentElement.dataset.shown = seen;
}

function legend() {  // buttons of equal classes stay, so that no click is lost while scans change
  const name = CATEGORIES[state.colour] ? state.colour : cloud.values.label ? "label" : "";
  const ids = cloud.values[name] ?? [], hidden = state.hidden[name], counts = new Uint32Array(256);
  for (const id of ids) counts[id]++;
  const present = [...(CATEGORIES[name] ?? []).keys()].filter(id => counts[id] || data.occurring[name].includes(id));
  const box = byId("legend");
  const key = [name, ...present].join();
  if (box.dataset.key !== key) box.replaceChildren(...present.map(id => entry(name, id, present)));
  box.style.setProperty("--entry", `${Math.max(0, ...present.map(id => CATEGORIES[name][id].name.length)) + 9}ch`);
  box.dataset.key = key;
  present.forEach((id, i) => {
    box.children[i].lastChild.textContent = `${CATEGORIES[name][id].name} ${(100 * counts[id] / cloud.shown).toFixed(1)} %`;
    box.children[i].classList.toggle("absent", !counts[id]);
    box.children[i].setAttribute("aria-pressed", !hidden.has(id));
  });
}

function entry(name, id, present) {  // of the legend
  const button = document.createElement("button"), swatch = document.createElement("i"), hidden = state.hidden[name];
  swatch.style.background = `rgb(${CATEGORIES[name][id].rgb})`;
  button.type = "button";
  button.append(swatch, "");
  const show = change => () => {
    change();
    filter();
    strip();
    legend();
    save();
  };
  button.addEventListener("click", show(() => hidden.delete(id) || hidden.add(id)));
  button.addEventListener("dblclick", show(() => {
    present.forEach(other => hidden.add(other));
    hidden.delete(id);
  }));
  return button;
}

function strip() {  // the range image: the nearest point of every pixel
  if (!cloud) return;
  const canvas = byId("strip"), { width, height, first, values } = cloud, ids = values[state.colour];
  const tall = Math.max(1, Math.round(width / height / 10));  // rows are drawn higher than wide
  Object.assign(canvas, { width, height });
  canvas.style.aspectRatio = `${width} / ${height * tall}`;
  const pen = canvas.getContext("2d"), image = pen.createImageData(width, height);
  for (let pixel = 0; pixel < width * height; pixel++) {
    const at = first[pixel], seen = at < first[pixel + 1] && visible[at];
    image.data.set(seen ? palette.subarray(4 * ids[at], 4 * ids[at] + 3) : [24, 27, 33], 4 * pixel);
    image.data[4 * pixel + 3] = 255;
  }
  pen.putImageData(image, 0, 0);
  cloud.image = image;
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
  if (cloud.image) {
    const pen = byId("strip").getContext("2d"), pixel = pixelOf(index);
    pen.putImageData(cloud.image, 0, 0);
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

function save() {  // the state in the address, after a pause: browsers refuse many changes at once
  clearTimeout(saving);
  if (cloud && !playing) saving = setTimeout(() => history.replaceState(null, "", `#${address()}`), 150);
}

function address() {
  const { hidden } = state, parts = { scan: cloud.name, colour: state.colour };
  if (state.by && state.above < TOP) Object.assign(parts, { by: state.by, above: +valueOf(state.by, state.above).toPrecision(3) });
  if (state.size !== 2) parts.size = state.size;
  if (hidden.label.size) parts.hide = [...hidden.label].map(id => data.classes[id].name).join(",");
  if (!state.boxes) parts.boxes = "no";
  return new URLSearchParams(parts);
}

function load() {  // the state from the address
  const linked = new URLSearchParams(location.hash.slice(1));
  const scan = data.shown.findIndex(({ name }) => name === linked.get("scan"));
  Object.values(state.hidden).forEach(ids => ids.clear());
  state.above = TOP;
  state.colour = linked.get("colour") ?? state.colour;
  state.by = linked.get("by") ?? state.by;
  state.size = +linked.get("size") || 2;
  const names = (linked.get("hide") ?? "").split(",");
  data.classes.forEach(({ name }, id) => names.includes(name) && state.hidden.label.add(id));
  threshold = linked.has("above") ? +linked.get("above") : null;
  byId("boxes").checked = state.boxes = linked.get("boxes") !== "no";
  byId("size").value = state.size;
  if (view) view.size = state.size;
  return choose(Math.max(0, scan));
}

function listen() {
  const on = (id, name, change) => byId(id).addEventListener(name, () => change(byId(id).value));
  on("scan", "change", value => choose(+value));
  on("place", "input", value => choose(+value));
  byId("play").addEventListener("click", () => playing ? stop() : play());
  on("colour", "change", value => { state.colour = value; paint(); });
  on("by", "change", value => { state.by = value; filter(); strip(); save(); });
  on("above", "input", value => { state.above = +value; filter(); strip(); });
  on("above", "change", save);
  on("size", "input", value => { state.size = +value; if (view) { view.size = +value; view.redraw(); } });
  on("size", "change", save);
  on("boxes", "change", () => { state.boxes = byId("boxes").checked; filter(); save(); });
  on("home", "click", () => view?.home());
  on("all", "click", () => {
    Object.values(state.hidden).forEach(ids => ids.clear());
    state.above = TOP;
    filter();
    paint();
  });
  byId("full").hidden = !document.fullscreenEnabled;
  byId("full").addEventListener("click", () => document.fullscreenElement ? document.exitFullscreen() : byId("stage").requestFullscreen());
  document.addEventListener("fullscreenchange", () => {
    byId("full").textContent = document.fullscreenElement ? "leave full screen" : "full screen";
  });
  byId("strip").addEventListener("pointermove", event => {
    if (!cloud) return;
    const { width, height, first } = cloud, canvas = byId("strip");
    const column = Math.floor(event.offsetX / canvas.clientWidth * width), row = Math.floor(event.offsetY / canvas.clientHeight * height);
    const pixel = row * width + column, at = first[pixel];
    point(at < first[pixel + 1] && visible[at] ? at : -1);
  });
  byId("strip").addEventListener("pointerleave", () => point(-1));
  addEventListener("hashchange", () => location.hash.includes("scan=") && load());
}

function start() {
  options(byId("scan"), [...data.shown.keys()], i => [data.shown[i].name, data.shown[i].reason].filter(Boolean).join(" · "));
  byId("place").max = data.shown.length - 1;
  byId("boxes").closest("label").hidden = !data.boxes;
  byId("through").hidden = data.shown.length < 2;
  for (const entry of data.classes) entry.css = `rgb(${entry.rgb})`;
  const scans = { ...data.drive, count: data.drive.names.length, marked: data.drive.shown.map(i => i >= 0 && data.shown[i].reason) };
  for (const name of ["shares", "uncertainty", "wrong"]) scans[name] = floats(scans[name]);
  drive = new DriveView(byId("columns"), byId("column"), scans, data.classes, index => {
    choose(index);
    byId("scans").scrollIntoView({ behavior: "smooth" });
  });
  try {
    view = new PointView(byId("cloud"));
    let pointed = null;  // one search for a point per frame
    steer(view, position => {
      pointed ?? requestAnimationFrame(() => { point(pointed.position ? view.pick(pointed.position.x, pointed.position.y) : -1); pointed = null; });
      pointed = { position };
    });
  } catch (error) {
    byId("hint").style.display = "block";
    byId("hint").textContent = `Cannot show points: ${error.message}.`;
  }
  listen();
  load().then(() => { document.documentElement.dataset.ready = "yes"; });
}

start();

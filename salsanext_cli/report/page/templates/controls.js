// SPDX-License-Identifier: MIT
// Controls of the page. The address contains the state, for links:
// #scan=08/000000&colour=error&beside=truth&by=error&above=0.3&size=2&hide=road,car&boxes=no&truth=road&taken=parking&tag=08/000000.

function save() {  // the state in the address, after a pause: browsers refuse many changes at once
  clearTimeout(saving);
  if (cloud && !playing) saving = setTimeout(() => history.replaceState(null, "", `#${address()}`), 150);
}

function address() {
  const { hidden, cell } = state, parts = { scan: cloud.name, colour: state.colour, beside: besides() };
  if (state.by && state.above < TOP) Object.assign(parts, { by: state.by, above: +valueOf(state.by, state.above).toPrecision(3) });
  if (state.size !== 2) parts.size = state.size;
  if (hidden.label.size) parts.hide = [...hidden.label].map(id => data.classes[id].name).join(",");
  if (!state.boxes) parts.boxes = "no";
  if (cell) Object.assign(parts, { truth: data.classes[cell.truth].name, taken: data.classes[cell.label].name });
  const linked = new URLSearchParams(parts);
  table.list().forEach(name => linked.append("tag", name));
  return linked;
}

function load() {  // the state from the address
  const linked = new URLSearchParams(location.hash.slice(1));
  const scan = data.shown.findIndex(({ name }) => name === linked.get("scan"));
  Object.values(state.hidden).forEach(ids => ids.clear());
  state.above = TOP;
  state.colour = linked.get("colour") ?? state.colour;
  state.beside = linked.get("beside") ?? state.beside;
  state.by = linked.get("by") ?? state.by;
  state.size = +linked.get("size") || 2;
  const classOf = key => data.classes.findIndex(({ name }) => name === linked.get(key));
  const cell = { truth: classOf("truth"), label: classOf("taken") };
  state.cell = cell.truth >= 0 && cell.label >= 0 ? cell : null;
  table.tags = new Set(linked.getAll("tag").filter(name => data.drive.names.includes(name)));
  table.draw();
  const names = (linked.get("hide") ?? "").split(",");
  data.classes.forEach(({ name }, id) => names.includes(name) && state.hidden.label.add(id));
  threshold = linked.has("above") ? +linked.get("above") : null;
  byId("boxes").checked = state.boxes = linked.get("boxes") !== "no";
  byId("size").value = state.size;
  if (view) view.size = state.size;
  return choose(Math.max(0, scan));
}

function tagged() {  // after a change of the tags
  if (cloud) byId("tag").checked = table.tags.has(cloud.name);
  save();
}

function repaint() {  // after a change of the panes
  if (!cloud) return;
  const panes = view?.panes.length;
  paint();
  if (view && view.panes.length !== panes) view.home();
}

function listen() {
  const on = (id, name, change) => byId(id).addEventListener(name, () => change(byId(id).value));
  on("scan", "change", value => choose(+value));
  on("place", "input", value => choose(+value));
  byId("play").addEventListener("click", () => playing ? stop() : play());
  on("colour", "change", value => { state.colour = value; repaint(); });
  on("beside", "change", value => { state.beside = value; repaint(); });
  on("tag", "change", () => cloud && table.tag(cloud.name, byId("tag").checked));
  byId("save").addEventListener("click", () => table.save());
  byId("more").addEventListener("click", () => { table.rows += 5 * ROWS_AT_ONCE; table.draw(); });
  byId("confusion")?.addEventListener("click", event => event.target.dataset.cell && showCell(event.target.dataset.cell));
  on("by", "change", value => { state.by = value; filter(); strips(); save(); });
  on("above", "input", value => { state.above = +value; filter(); strips(); });
  on("above", "change", save);
  on("size", "input", value => { state.size = +value; if (view) { view.size = +value; view.redraw(); } });
  on("size", "change", save);
  on("boxes", "change", () => { state.boxes = byId("boxes").checked; filter(); save(); });
  on("home", "click", () => view?.home());
  on("all", "click", () => {
    Object.values(state.hidden).forEach(ids => ids.clear());
    Object.assign(state, { above: TOP, cell: null });
    filter();
    paint();
  });
  byId("full").hidden = !document.fullscreenEnabled;
  byId("full").addEventListener("click", () => document.fullscreenElement ? document.exitFullscreen() : byId("stage").requestFullscreen());
  document.addEventListener("fullscreenchange", () => {
    byId("full").textContent = document.fullscreenElement ? "leave full screen" : "full screen";
  });
  for (const canvas of [byId("strip"), byId("beside-strip")]) {
    canvas.addEventListener("pointermove", event => {
      if (!cloud) return;
      const { width, height, first } = cloud;
      const column = Math.floor(event.offsetX / canvas.clientWidth * width), row = Math.floor(event.offsetY / canvas.clientHeight * height);
      const pixel = row * width + column, at = first[pixel];
      point(at < first[pixel + 1] && visible[at] === 1 ? at : -1);
    });
    canvas.addEventListener("pointerleave", () => point(-1));
  }
  addEventListener("hashchange", () => location.hash.includes("scan=") && load());
}

function start() {
  options(byId("scan"), [...data.shown.keys()], i => [data.shown[i].name, data.shown[i].reason].filter(Boolean).join(" · "));
  byId("place").max = data.shown.length - 1;
  byId("boxes").closest("label").hidden = !data.boxes;
  byId("through").hidden = data.shown.length < 2;
  for (const entry of data.classes) entry.css = `rgb(${entry.rgb})`;
  const scans = { ...data.drive, count: data.drive.names.length, marked: data.drive.shown.map(i => i >= 0 && data.shown[i].reason) };
  for (const name of ["shares", "uncertainty", "wrong", "doubtful", "rejected"]) scans[name] = floats(scans[name]);
  const open = index => {
    choose(index);
    byId("scans").scrollIntoView({ behavior: "smooth" });
  };
  drive = new DriveView(byId("columns"), byId("column"), scans, data.classes, open);
  table = new ScanTable(byId("table"), scans, data.classes, { open, changed: tagged });
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

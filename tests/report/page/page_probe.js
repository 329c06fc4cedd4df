// SPDX-License-Identifier: MIT
import { fitted, matrixOf } from "page/camera.js";
import { byId, data } from "page/data.js";
import { pixelOf } from "page/range_images.js";
import { valueOf } from "page/scales.js";
import { choose } from "page/scans.js";
import { page, state } from "page/state.js";

const { view, table } = page;
const shown = () => +document.documentElement.dataset.shown;
const result = { shown: shown(), summary: byId("summary").textContent };
const picture = () => {
  view.draw();
  const { gl } = view, { width, height } = gl.canvas;
  const pixels = new Uint8Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  return new Set(new Uint32Array(pixels.buffer));
};
const change = (id, value, name) => {
  byId(id).value = value;
  byId(id).dispatchEvent(new Event(name));
};
const legend = () => [...byId("legend").children];
const at = (target, name, x, y) => target.dispatchEvent(
  new PointerEvent(name, { clientX: x, clientY: y, bubbles: true, pointerId: 1 }));
const half = right => {  // of the picture: its colours
  view.draw();
  const { gl } = view, { width, height } = gl.canvas, pixels = new Uint8Array(2 * width * height);
  gl.readPixels(right ? width / 2 + 1 : 0, 0, width / 2 - 1, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  return new Set(new Uint32Array(pixels.buffer));
};
const cssOf = entries => entries.map(({ rgb }) => (255 * 2 ** 24 + rgb[2] * 65536 + rgb[1] * 256 + rgb[0]));
(async () => {
  result.panes = [view.panes.length, byId("beside").value, byId("names").hidden];
  change("beside", "", "change");
  result.state = [byId("scan").value, byId("colour").value, byId("by").value, byId("size").value];
  result.colours = Object.fromEntries([...byId("colour").options].map(({ value }) => {
    change("colour", value, "change");
    return [value, picture().size];
  }));
  change("colour", "label", "change");
  byId("all").click();
  result.boxed = ["wrong", "label"].map(colour => {
    change("colour", colour, "change");
    const boxed = picture().size;
    byId("boxes").click();
    const without = picture().size;
    byId("boxes").click();
    return boxed - without;
  });
  result.all = shown();
  result.legend = legend().map(button => button.textContent);
  legend()[0].click();
  result.pressed = legend()[0].getAttribute("aria-pressed");
  await new Promise(done => setTimeout(done, 300));
  result.without = [shown(), picture().size, location.hash];
  legend()[1].dispatchEvent(new MouseEvent("dblclick"));
  result.alone = shown();
  byId("all").click();
  change("by", "entropy", "change");
  change("above", 64, "input");
  result.below = [shown(), byId("above-value").textContent];
  data.scales.error = { marks: [0, 0.1, 1], unit: "" };
  result.marks = [0, 127, 254].map(byte => valueOf("error", byte));
  byId("all").click();
  view.azimuth = 0; view.elevation = 89; view.draw();
  const m = view.matrix(), [x, y, z] = view.place(700);
  const canvas = byId("cloud"), box = canvas.getBoundingClientRect();
  const row = i => m[i] * x + m[4 + i] * y + m[8 + i] * z + m[12 + i];
  const px = (row(0) / row(3) + 1) / 2 * box.width;
  const py = (1 - row(1) / row(3)) / 2 * box.height;
  result.picked = view.pick(px, py);
  at(canvas, "pointermove", box.left + px, box.top + py);
  await new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));
  const point = byId("point");
  result.hover = [point.hidden, point.textContent, +document.documentElement.dataset.point];
  const before_hiding = point.hidden, label = page.cloud.values.label[result.picked];
  const button = legend().find(entry => entry.textContent.startsWith(data.classes[label].name));
  button.click();
  result.hidden = [before_hiding, point.hidden, view.marked];
  button.click();
  const stage = byId("full").closest("#stage");
  const controls = ["cloud", "play", "colour", "above", "legend"];
  stage.requestFullscreen = () => { result.full = controls.every(id => stage.contains(byId(id))); };
  byId("full").click();
  const before = view.azimuth;
  canvas.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft" }));
  result.turned = view.azimuth - before;
  result.pixels = Array.from({ length: page.cloud.shown }, (_, i) => pixelOf(i))
    .every((pixel, i) => pixel < 0 || (page.cloud.first[pixel] <= i && i < page.cloud.first[pixel + 1]));
  const strip = byId("strip"), area = strip.getBoundingClientRect(), pixel = pixelOf(700);
  at(strip, "pointermove", area.left + (pixel % page.cloud.width + 0.5) * area.width / page.cloud.width,
    area.top + (Math.floor(pixel / page.cloud.width) + 0.5) * area.height / page.cloud.height);
  result.strip = [page.cloud.first[pixel], +document.documentElement.dataset.point];
  const inside = scan => {  // share of its points that the fitted camera shows
    const aspect = 0.7, k = matrixOf(fitted(scan, aspect), aspect), { low, step, position } = scan;
    let count = 0;
    for (let i = 0; i < scan.shown; i++) {
      const at = [0, 1, 2].map(axis => low[axis] + step[axis] * position[3 * i + axis]);
      const [u, v, , w] = [0, 1, 2, 3].map(row => k[row] * at[0] + k[4 + row] * at[1] + k[8 + row] * at[2] + k[12 + row]);
      count += w > 0 && Math.abs(u) <= w && Math.abs(v) <= w;
    }
    return count / scan.shown;
  };
  const sector = Uint16Array.from({ length: 3000 }, (_, i) => i % 3 === 2 ? 0 : (i * 7919) % 1000);
  const left = { shown: 1000, position: sector, low: [-5, 10, 0], step: [0.01, 0.02, 0.01] };
  const far = { ...left, low: [1e5, 1e5, 0] };
  result.inside = [page.cloud, left, far].map(inside);
  result.azimuths = [page.cloud, left, far].map(scan => Math.round(fitted(scan, 1).azimuth));
  byId("boxes").click();
  change("beside", "wrong", "change");
  const wrong = cssOf(data.outcomes)[2], car = cssOf(data.classes)[1];
  result.halves = [false, true].map(right => [wrong, car].map(colour => half(right).has(colour)));
  const { width, height } = view.pane(), n = view.matrix(), part = i => n[i] * x + n[4 + i] * y + n[8 + i] * z + n[12 + i];
  const [a, b] = [(part(0) / part(3) + 1) / 2 * width, (1 - part(1) / part(3)) / 2 * height];
  result.both = [view.pick(a, b), view.pick(a + width, b)];
  result.strips = byId("beside-strip").hidden;
  byId("confusion").querySelector("[data-cell='9,1']").click();
  await new Promise(done => setTimeout(done, 300));
  result.cell = [page.cloud.name, shown(), byId("summary").textContent, location.hash];
  result.faint = page.cloud.values.label.every((id, i) =>
    page.visible[i] === (id === 1 && page.cloud.values.truth[i] === 9 ? 1 : 2));
  byId("all").click();
  result.cleared = [shown(), state.cell];
  change("colour", "entropy", "change");
  result.ticks = [...byId("scale").querySelectorAll(".ticks span")].map(tick => tick.textContent);
  result.scales = [byId("scale").hidden, byId("beside-scale").hidden];
  const scans = () => [...document.querySelectorAll("#table tbody tr")].map(row => row.dataset.scan);
  const heading = name => [...document.querySelectorAll("#table th button")].find(button => button.textContent === name);
  result.rows = [scans()];
  for (const name of ["mean entropy", "scan", "scan"]) { heading(name).click(); result.rows.push(scans()); }
  result.sorted = document.querySelector("#table th[aria-sort]").textContent;
  result.columns = [...document.querySelectorAll("#table th")].map(cell => cell.textContent);
  result.plots = [...document.querySelectorAll(".plots figure")].map(figure => figure.offsetWidth);
  result.links = [...document.querySelectorAll("nav a")].map(link =>
    [link.textContent, document.querySelector(`${link.getAttribute("href")} h2`).textContent]);
  result.pictures = [...document.querySelectorAll("#table img")].map(image => image.naturalWidth);
  const tagged = document.querySelector("#table tr[data-scan='08/000000'] input");
  result.nothing = byId("save").disabled;
  tagged.click();
  await choose(0);
  byId("tag").click();
  await new Promise(done => setTimeout(done, 300));
  result.tags = [table.save(), byId("save").disabled, new URLSearchParams(location.hash.slice(1)).getAll("tag")];
  tagged.click();
  result.untagged = table.list();
  byId("columns").dispatchEvent(new KeyboardEvent("keydown", { key: "End" }));
  byId("columns").dispatchEvent(new KeyboardEvent("keydown", { key: "Enter" }));
  result.opened = [page.cloud.name, byId("column").textContent];
  result.fetched = performance.getEntriesByType("resource").length;
  console.log("RESULT " + JSON.stringify(result));
})();

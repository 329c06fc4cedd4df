// SPDX-License-Identifier: MIT
import { byId } from "page/data.js";
import { page } from "page/state.js";

const { view } = page;
(async () => {
  const soon = () => new Promise(done => setTimeout(done, 20));
  const until = async there => { while (!there()) await soon(); };
  const change = (id, value, name) => {
    byId(id).value = value;
    byId(id).dispatchEvent(new Event(name));
  };
  const played = async () => {
    result.from = [];
    byId("play").click();
    result.playing = byId("play").textContent;
    await until(() => byId("play").textContent === "play");
  };
  const result = { early: view.pick(100, 100), from: [] };
  byId("strip").dispatchEvent(new PointerEvent("pointermove", { clientX: 1, clientY: 1 }));
  await until(() => page.cloud);
  Object.assign(result, { first: page.cloud.name, left: document.documentElement.dataset.shown });
  view.show = (old => cloud => { result.from.push(cloud.name); old.call(view, cloud); })(view.show);
  await played();
  result.unread = byId("unread").textContent;
  result.played = [[...result.from], page.cloud.name, byId("place").value];
  result.column = byId("column").textContent;
  for (const place of [0, 1, 3, 0]) change("place", place, "input");
  await until(() => page.cloud.name === "08/000000");
  result.summary = byId("summary").textContent;
  result.legend = byId("legend").children[0];
  change("scan", 1, "change");
  await until(() => page.cloud.name === "08/000001");
  result.legend = result.legend === byId("legend").children[0];
  byId("play").click();
  change("scan", 0, "change");
  await until(() => page.cloud.name === "08/000000");
  await new Promise(done => setTimeout(done, 500));
  result.chosen = [page.cloud.name, byId("play").textContent];
  byId("columns").dispatchEvent(new KeyboardEvent("keydown", { key: "End" }));
  byId("columns").dispatchEvent(new KeyboardEvent("keydown", { key: "Enter" }));
  await until(() => page.cloud.name === "08/000003");
  result.colours = [...byId("colour").options].map(option => option.value);
  change("scan", 2, "change");
  await until(() => byId("scan").value === "3");
  result.failed = [byId("summary").textContent, page.cloud.name];
  const paths = performance.getEntriesByType("resource").map(entry => new URL(entry.name).pathname);
  result.fetched = paths.map(path => path.split("/").pop());
  console.log("RESULT " + JSON.stringify(result));
})();

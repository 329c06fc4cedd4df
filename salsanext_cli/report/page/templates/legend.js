// SPDX-License-Identifier: MIT
// The legend of classes, whose entries hide and show them, and the points of a confusion.

function legend() {  // of a colouring by class; buttons of equal classes stay, so that no click is lost while scans change
  const name = [state.colour, state.beside].find(colour => CATEGORIES[colour] && cloud.values[colour]) ?? "";
  const ids = cloud.values[name] ?? [], hidden = state.hidden[name], counts = new Uint32Array(256);
  for (const id of ids) counts[id]++;
  const present = [...(CATEGORIES[name] ?? []).keys()].filter(id => counts[id] || data.occurring[name].includes(id));
  const box = byId("legend");
  const key = [name, ...present].join();
  if (box.dataset.key !== key) box.replaceChildren(...present.map(id => entry(name, id, present)));
  box.style.setProperty("--entry", `${Math.max(0, ...present.map(id => CATEGORIES[name][id].name.length)) + 8}ch`);
  box.dataset.key = key;
  byId("legend-hint").hidden = !present.length;
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
    strips();
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

async function showCell(key) {  // of the confusion matrix: its points in the scan with most of them, the others faint
  const [shown, most] = data.cells[key];
  const [truth, label] = key.split(",").map(Number);
  const words = cellWords({ truth, label });
  if (shown < 0) {
    byId("cell").textContent = `No scan of this page has ${words}. Most are in ${most}: run report with --scans ${most}.`;
    return;
  }
  byId("cell").textContent = `${data.shown[shown].name} has most ${words} of the scans of this page.`;
  Object.values(state.hidden).forEach(ids => ids.clear());
  Object.assign(state, { cell: { truth, label }, above: TOP });
  await choose(shown);
  byId("scans").scrollIntoView({ behavior: "smooth" });
}

function cellWords({ truth, label }) {
  const name = id => data.classes[id].name;
  return truth === label ? `points of ${name(truth)} with the right label` : `points of ${name(truth)} taken for ${name(label)}`;
}

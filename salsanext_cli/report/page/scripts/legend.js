// SPDX-License-Identifier: MIT
// The legend of classes, whose entries hide and show them.

import { byId, CATEGORIES, data } from "./data.js";
import { page, state } from "./state.js";

export function drawLegend(changed) {  // of a colouring by class; `changed`: called after a class was hidden or shown
  const { cloud } = page;
  const name = [state.colour, state.beside].find(colour => CATEGORIES[colour] && cloud.values[colour]) ?? "";
  const classes = CATEGORIES[name] ?? [];
  const counts = new Uint32Array(256);
  for (const id of cloud.values[name] ?? []) counts[id]++;
  const present = [...classes.keys()].filter(id => counts[id] || data.occurring[name].includes(id));
  const box = byId("legend");
  const key = [name, ...present].join();
  // Buttons of equal classes stay, so that no click is lost while scans change.
  if (box.dataset.key !== key) box.replaceChildren(...present.map(id => entry(name, id, present, changed)));
  box.dataset.key = key;
  const longest = Math.max(0, ...present.map(id => classes[id].name.length));
  box.style.setProperty("--entry", `${longest + 8}ch`);
  byId("legend-hint").hidden = !present.length;
  present.forEach((id, i) => {
    const button = box.children[i];
    button.lastChild.textContent = `${classes[id].name} ${(100 * counts[id] / cloud.shown).toFixed(1)} %`;
    button.classList.toggle("absent", !counts[id]);
    button.setAttribute("aria-pressed", !state.hidden[name].has(id));
  });
}

function entry(name, id, present, changed) {  // button of a class; `present`: all classes of the legend
  const hidden = state.hidden[name];
  const swatch = document.createElement("i");
  swatch.style.background = `rgb(${CATEGORIES[name][id].rgb})`;
  const button = document.createElement("button");
  button.type = "button";
  button.append(swatch, "");
  button.addEventListener("click", () => {
    if (!hidden.delete(id)) hidden.add(id);
    changed();
    drawLegend(changed);
  });
  button.addEventListener("dblclick", () => {
    present.forEach(other => hidden.add(other));
    hidden.delete(id);
    changed();
    drawLegend(changed);
  });
  return button;
}

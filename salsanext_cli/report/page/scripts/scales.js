// SPDX-License-Identifier: MIT
// Scales of values: round marks, and a colour bar with ticks.

import { data, NO_VALUE, paletteOf, title, TOP } from "./data.js";

const MARKS = 5;  // about so many on a linear scale

export function roundMarks(most) {  // from 0, at steps of 1, 2 or 5 times a power of ten; the last one is at least `most`
  if (!(most > 0)) return [0, 1];
  const rough = most / MARKS;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * ([1, 2, 5].find(times => times * power >= rough * 0.999) ?? 10);
  return Array.from({ length: Math.ceil(most / step - 1e-9) + 1 }, (_, i) => +(i * step).toPrecision(12));
}

export function valueOf(name, byte) {  // in the unit of the scale
  const { marks } = data.scales[name];
  const place = byte / TOP * (marks.length - 1);
  const i = Math.min(Math.floor(place), marks.length - 2);
  return marks[i] + (marks[i + 1] - marks[i]) * (place - i);
}

function placeOf(name, value) {  // 0 to 1 along the colour bar
  const { marks } = data.scales[name];
  const last = marks.length - 1;
  const i = Math.max(0, Math.min(last - 1, marks.findLastIndex(mark => mark <= value)));
  return (i + (value - marks[i]) / (marks[i + 1] - marks[i])) / last;
}

function isClipped(name) {  // whether larger values have the colour of the last one
  return name !== "error" && name !== "least_confidence";
}

export function shownValue(name, byte) {
  if (byte === NO_VALUE) return "none";
  const beyond = byte === TOP && isClipped(name) ? "≥ " : "";
  return `${beyond}${+valueOf(name, byte).toPrecision(3)} ${data.scales[name].unit}`.trim();
}

export function drawScale(box, name) {  // hidden for colours that are no values
  const scale = data.scales[name];
  box.hidden = !scale;
  if (!scale) return;
  const most = scale.marks[scale.marks.length - 1];
  const marks = scale.marks.length > 2 ? scale.marks : roundMarks(most).filter(mark => mark <= most);
  const unit = scale.unit && `, ${scale.unit}`;
  const clipped = isClipped(name) ? ` (brightest: ${+most.toPrecision(3)} or more)` : "";
  box.querySelector(".name").textContent = `${title(name)}${unit}${clipped}`;
  box.querySelector(".ticks").replaceChildren(...marks.map(mark => tick(name, mark)));
  const pen = box.querySelector("canvas").getContext("2d");
  const image = pen.createImageData(TOP + 1, 1);
  image.data.set(paletteOf(name).subarray(0, 4 * (TOP + 1)));
  pen.putImageData(image, 0, 0);
}

function tick(name, mark) {
  const element = document.createElement("span");
  element.style.left = `${100 * placeOf(name, mark)}%`;
  element.textContent = +mark.toPrecision(3);
  return element;
}

// SPDX-License-Identifier: MIT
// The data in the page, and the names that it has for classes and values.

export const byId = id => document.getElementById(id);
export const data = JSON.parse(byId("data").textContent);

export const NO_VALUE = 255;  // byte of a point without a value
export const TOP = 254;  // byte of the largest value
export const WRONG = 2;  // index of wrong points in `data.outcomes`
export const JUDGED = data.drive.judged;  // the points that are right or wrong, in words
export const CATEGORIES = { label: data.classes, truth: data.classes, wrong: data.outcomes };

export const TITLES = { ...data.titles, wrong: "right or wrong" };

export function title(name) {
  return TITLES[name] ?? name.replaceAll("_", " ");
}

export function percentOf(share) {
  return Number.isNaN(share) ? "–" : `${(100 * share).toFixed(1)} %`;
}

export function bytes(text) {  // of base64
  return Uint8Array.from(atob(text), character => character.charCodeAt(0));
}

export function floats(text) {  // of base64; null for no text
  return text ? new Float32Array(bytes(text).buffer) : null;
}

export function cellWords({ truth, label }) {  // the points of a cell of the confusion matrix
  const nameOf = id => data.classes[id].name;
  if (truth === label) return `points of ${nameOf(truth)} with the right label`;
  return `points of ${nameOf(truth)} taken for ${nameOf(label)}`;
}

export function paletteOf(colour) {  // 256 colours of 4 bytes
  const rgba = new Uint8Array(1024).fill(70);
  if (CATEGORIES[colour]) {
    CATEGORIES[colour].forEach(({ rgb }, i) => rgba.set([...rgb, 255], 4 * i));
    return rgba;
  }
  for (let i = 0; i <= TOP; i++) rgba.set([...data.map.slice(3 * i, 3 * i + 3), 255], 4 * i);
  return rgba;
}

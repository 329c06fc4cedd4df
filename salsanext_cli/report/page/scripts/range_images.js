// SPDX-License-Identifier: MIT
// The range images below the points: the nearest point of every pixel, in the same colours.

import { byId, paletteOf } from "./data.js";
import { besides, page, state } from "./state.js";

const FAINT = [59, 64, 71];
const EMPTY = [24, 27, 33];
const NEEDED_ASPECT = 10;  // rows are drawn higher than wide, until an image is about so wide for its height
const drawn = new Map();  // pixels of each canvas, without the mark

export function rangeImages() {  // their canvases
  return [byId("strip"), byId("beside-strip")];
}

export function drawRangeImages() {
  if (!page.cloud) return;
  const [first, second] = rangeImages();
  const beside = besides();
  draw(first, state.colour);
  second.hidden = !beside;
  if (beside) draw(second, beside);
}

function draw(canvas, colour) {
  const { width, height, first, values } = page.cloud;
  const ids = values[colour];
  const palette = paletteOf(colour);
  const tall = Math.max(1, Math.round(width / height / NEEDED_ASPECT));
  canvas.width = width;
  canvas.height = height;
  canvas.style.aspectRatio = `${width} / ${height * tall}`;
  const pen = canvas.getContext("2d");
  const image = pen.createImageData(width, height);
  for (let pixel = 0; pixel < width * height; pixel++) {
    const point = first[pixel];
    const seen = point < first[pixel + 1] ? page.visible[point] : 0;
    let rgb = EMPTY;
    if (seen === 1) rgb = palette.subarray(4 * ids[point], 4 * ids[point] + 3);
    else if (seen) rgb = FAINT;
    image.data.set(rgb, 4 * pixel);
    image.data[4 * pixel + 3] = 255;
  }
  pen.putImageData(image, 0, 0);
  drawn.set(canvas, image);
}

export function pixelOf(index) {  // -1 for a point without a pixel
  const { first } = page.cloud;
  if (index < 0 || index >= first[first.length - 1]) return -1;
  let low = 0;
  let high = first.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (first[middle] <= index) low = middle;
    else high = middle;
  }
  return low;
}

export function pointAt(canvas, event) {  // the visible point under the pointer; -1 without one
  const { width, height, first } = page.cloud;
  const column = Math.floor(event.offsetX / canvas.clientWidth * width);
  const row = Math.floor(event.offsetY / canvas.clientHeight * height);
  const pixel = row * width + column;
  const point = first[pixel];
  return point < first[pixel + 1] && page.visible[point] === 1 ? point : -1;
}

export function markInRangeImages(index) {  // a frame around the pixel of a point; none for -1
  const pixel = pixelOf(index);
  const column = pixel % page.cloud.width;
  const row = Math.floor(pixel / page.cloud.width);
  for (const canvas of rangeImages()) {
    if (!drawn.has(canvas) || canvas.hidden) continue;
    const pen = canvas.getContext("2d");
    pen.putImageData(drawn.get(canvas), 0, 0);
    pen.strokeStyle = "#fff";
    if (pixel >= 0) pen.strokeRect(column - 3.5, row - 1.5, 8, 4);
  }
}

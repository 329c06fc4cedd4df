// SPDX-License-Identifier: MIT
// Scans of the page: their points, from the page or its server, and the animation of the drive.

import { save } from "./address.js";
import { byId, bytes, data } from "./data.js";
import { show, summarise } from "./points.js";
import { page, state } from "./state.js";

const CACHED = 20;  // scans from the server in memory
const PAUSE_MS = 100;  // shortest time between scans of the animation
const ARRAY_OF = { 1: Uint8Array, 2: Uint16Array, 4: Uint32Array };  // by bytes of a number
const cache = new Map();  // points by index, the last used at the end
const unread = new Set();  // indices of unreadable scans
let wanted = 0;  // index of the scan that was chosen last
let run = 0;  // number of the animation that may go on
let lane = Promise.resolve();  // end of the last request to the server

function decoded(raw) {
  const ofPixel = new ARRAY_OF[raw.of_pixel_bytes](bytes(raw.of_pixel).buffer);
  const first = new Uint32Array(ofPixel.length + 1);  // first point of every pixel, and the end
  ofPixel.forEach((count, pixel) => { first[pixel + 1] = first[pixel] + count; });
  const values = Object.fromEntries(Object.entries(raw.values).map(([name, text]) => [name, bytes(text)]));
  return { ...raw, values, first, position: new Uint16Array(bytes(raw.position).buffer) };
}

function fromPage(index) {
  return decoded(JSON.parse(byId(`cloud-${index}`).textContent));
}

function cloudAt(index) {  // undefined if only the server has it
  const points = cache.get(index) ?? (data.live ? undefined : fromPage(index));
  cache.delete(index);
  if (points) cache.set(index, points);
  return points;
}

async function answerAbout(index) {
  try {
    return await fetch(`cloud/${data.token}/${index}`);
  } catch {
    throw new Error("no answer: salsanext view has ended");
  }
}

async function fetchScan(index) {
  const answer = await answerAbout(index);
  if (answer.headers.get("Content-Type") !== "application/json") throw new Error(`the server answers ${answer.status}`);
  const scan = await answer.json();
  if (scan.error) throw new Error(scan.error);
  Object.assign(data.scales, scan.scales);
  cache.set(index, decoded(scan));
  unread.delete(index);
  if (cache.size > CACHED) cache.delete(cache.keys().next().value);
}

function request(index, isNeeded) {  // one at a time, unless it is no longer needed
  const done = lane.then(() => isNeeded() && !cache.has(index) ? fetchScan(index) : null);
  lane = done.catch(() => {});
  return done;
}

function setControls(index) {
  wanted = index;
  byId("scan").value = index;
  byId("place").value = index;
  byId("place").setAttribute("aria-valuetext", data.shown[index].name);
}

async function open(index) {
  setControls(index);
  try {
    if (!cloudAt(index)) {
      byId("summary").textContent = `loading ${data.shown[index].name} …`;
      await request(index, () => wanted === index);
    }
    if (wanted === index) show(index, cloudAt(index));
  } catch (error) {
    unread.add(index);
    const scans = unread.size > 1 ? `${unread.size} scans could not be read, the last` : "could not be read";
    byId("unread").textContent = `${scans}: ${data.shown[index].name}: ${error.message}`;
    if (wanted !== index) return;
    if (page.cloud) setControls(state.scan);
    summarise();
  }
}

export function choose(index) {  // end the animation and open a scan
  stop();
  return open(index);
}

export async function play() {  // from this scan to the last, or from the first
  run++;
  const mine = run;
  const last = data.shown.length - 1;
  setPlaying(true);
  for (let next = wanted < last ? wanted + 1 : 0; next <= last && run === mine; next++) {
    const pause = new Promise(done => { setTimeout(done, PAUSE_MS); });
    await open(next);
    if (data.live && next < last) request(next + 1, () => run === mine).catch(() => {});
    await pause;
  }
  if (run === mine) stop();
}

export function stop() {
  if (!page.playing) return;
  run++;
  setPlaying(false);
  save();
}

function setPlaying(isPlaying) {
  page.playing = isPlaying;
  byId("play").textContent = isPlaying ? "pause" : "play";
  for (const id of ["summary", "column"]) byId(id).setAttribute("aria-live", isPlaying ? "off" : "polite");
}

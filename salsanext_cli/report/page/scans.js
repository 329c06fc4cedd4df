// SPDX-License-Identifier: MIT
// Scans of the page: their points, which the page holds or asks its server for, and playing them.

const KEPT = 20, PAUSE_MS = 100;  // scans kept of those asked for; shortest time between two that are played
const kept = new Map(), unread = new Set();  // points by place, the last used at the end; places that could not be read
let wanted = 0, playing = false, run = 0, lane = Promise.resolve();

function decoded(raw) {
  const ofPixel = new ({ 1: Uint8Array, 2: Uint16Array, 4: Uint32Array })[raw.of_pixel_bytes](bytes(raw.of_pixel).buffer);
  const first = new Uint32Array(ofPixel.length + 1);  // point of each pixel, and where the next one's begin
  ofPixel.forEach((count, pixel) => { first[pixel + 1] = first[pixel] + count; });
  const values = Object.fromEntries(Object.entries(raw.values).map(([name, text]) => [name, bytes(text)]));
  return { ...raw, values, first, position: new Uint16Array(bytes(raw.position).buffer) };
}

function cloudAt(index) {  // undefined if the server has to be asked
  const found = kept.get(index) ?? (data.live ? undefined : decoded(JSON.parse(byId(`cloud-${index}`).textContent)));
  kept.delete(index);
  if (found) kept.set(index, found);
  return found;
}

async function ask(index) {
  const answer = await fetch(`cloud/${data.token}/${index}`).catch(() => { throw new Error("no answer: salsanext view has ended"); });
  if (answer.headers.get("Content-Type") !== "application/json") throw new Error(`the server answers ${answer.status}`);
  const found = await answer.json();
  if (found.error) throw new Error(found.error);
  Object.assign(data.scales, found.scales);
  kept.set(index, decoded(found));
  unread.delete(index);
  if (kept.size > KEPT) kept.delete(kept.keys().next().value);
}

function asked(index, needed) {  // one request at a time, and none for what is not needed any more
  const done = lane.then(() => needed() && !kept.has(index) ? ask(index) : null);
  lane = done.catch(() => {});
  return done;
}

function turnTo(index) {  // the controls
  wanted = index;
  byId("scan").value = byId("place").value = index;
  byId("place").setAttribute("aria-valuetext", data.shown[index].name);
}

async function open(index) {
  turnTo(index);
  try {
    if (!cloudAt(index)) {
      byId("told").textContent = `loading ${data.shown[index].name} …`;
      await asked(index, () => wanted === index);
    }
    if (wanted === index) show(index, cloudAt(index));
  } catch (error) {
    unread.add(index);
    const scans = unread.size > 1 ? `${unread.size} scans could not be read, the last` : "could not be read";
    byId("unread").textContent = `${scans}: ${data.shown[index].name}: ${error.message}`;
    if (wanted !== index) return;
    if (cloud) turnTo(state.scan);
    tell();
  }
}

function choose(index) {  // as the user does, which ends playing
  stop();
  return open(index);
}

async function play() {  // from the present scan to the last, or from the first
  const mine = ++run, last = data.shown.length - 1;
  setPlaying(true);
  for (let next = wanted < last ? wanted + 1 : 0; next <= last && run === mine; next++) {
    const pause = new Promise(done => setTimeout(done, PAUSE_MS));
    await open(next);
    if (data.live && next < last) asked(next + 1, () => run === mine).catch(() => {});
    await pause;
  }
  if (run === mine) stop();
}

function stop() {
  if (!playing) return;
  run++;
  setPlaying(false);
  remember();
}

function setPlaying(on) {
  playing = on;
  byId("play").textContent = on ? "pause" : "play";
  for (const id of ["told", "column"]) byId(id).setAttribute("aria-live", on ? "off" : "polite");
}

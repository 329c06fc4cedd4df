"use strict";
// SPDX-License-Identifier: MIT
// The camera of a point view: its axes, its matrix, and the position from which most points are visible.

const START = { azimuth: 180, elevation: 32 };  // degrees: looking forward
const NEAR_M = 0.3, FAR_M = 20000, FOCAL = 1 / Math.tan(25 * Math.PI / 180);  // field of view: 50 degrees
const SAMPLED = 5000;  // points from which the position follows
const SHARE_INSIDE = 0.9;  // of the points, within the picture
const OUTER = 0.05;  // share of the points beyond each side of those that the target is in the middle of
const LEAST_DISTANCE_M = 4;
const FARTHEST = 2;  // distance of the target from the origin, in extents; farther scans are in the frame of a map

function multiply(a, b) {  // of 4 × 4 matrices, column by column
  return Float32Array.from({ length: 16 }, (_, i) =>
    [0, 1, 2, 3].reduce((sum, k) => sum + a[(i & 3) + 4 * k] * b[k + (i & 12)], 0));
}

function quantile(values, share) {
  const sorted = Float64Array.from(values).sort();
  return sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))] ?? 0;
}

function fitted(cloud, aspect) {  // azimuth, elevation, target and distance for a scan
  const { low, step, position, shown } = cloud, every = Math.max(1, Math.floor(shown / SAMPLED));
  const axes = [[], [], []];
  for (let i = 0; i < shown; i += every) axes.forEach((axis, k) => axis.push(low[k] + step[k] * position[3 * i + k]));
  const sides = axes.slice(0, 2).map(axis => [quantile(axis, OUTER), quantile(axis, 1 - OUTER)]);
  const target = [...sides.map(([low, high]) => (low + high) / 2), quantile(axes[2], 0.5)];
  const outside = sides.some(([low, high]) => low > 0 || high < 0);  // the origin: the points lie in one direction of it
  const near = Math.hypot(target[0], target[1]) < FARTHEST * Math.max(...sides.map(([low, high]) => high - low));
  const azimuth = outside && near ? Math.atan2(target[1], target[0]) * 180 / Math.PI + 180 : START.azimuth;
  const camera = { ...START, azimuth, target }, turned = axesOf(camera);
  const needed = axes[0].map((_, i) => {  // distance from which a point is just within the picture
    const [right, up, back] = turned.map(axis => axis.reduce((sum, each, k) => sum + each * (axes[k][i] - target[k]), 0));
    return back + FOCAL * Math.max(Math.abs(right) / aspect, Math.abs(up));
  });
  return { ...camera, distance: Math.max(LEAST_DISTANCE_M, quantile(needed, SHARE_INSIDE)) };
}

function axesOf({ azimuth, elevation }) {  // right, up, back
  const a = azimuth * Math.PI / 180, e = elevation * Math.PI / 180;
  const back = [Math.cos(a) * Math.cos(e), Math.sin(a) * Math.cos(e), Math.sin(e)];
  const right = [-Math.sin(a), Math.cos(a), 0];
  const up = [-Math.cos(a) * Math.sin(e), -Math.sin(a) * Math.sin(e), Math.cos(e)];
  return [right, up, back];
}

function matrixOf(camera, aspect) {
  const axes = axesOf(camera), eye = camera.target.map((t, i) => t + camera.distance * axes[2][i]);
  const turned = [0, 1, 2, 3].flatMap(column => column < 3 ? [...axes.map(axis => axis[column]), 0]
    : [...axes.map(axis => -axis.reduce((sum, each, i) => sum + each * eye[i], 0)), 1]);
  const near = Math.max(NEAR_M, camera.distance / 200);
  const depth = 1 / (near - FAR_M);
  return multiply([FOCAL / aspect, 0, 0, 0, 0, FOCAL, 0, 0, 0, 0, (FAR_M + near) * depth, -1,
    0, 0, 2 * FAR_M * near * depth, 0], turned);
}

// SPDX-License-Identifier: MIT
// The camera of a point view: its axes, its matrix, and the position from which most points are visible.

export const START = { azimuth: 180, elevation: 32 };  // degrees: looking forward
export const NEAR_M = 0.3;
const FAR_M = 20000;
const FOCAL = 1 / Math.tan(25 * Math.PI / 180);  // field of view: 50 degrees
const SAMPLED = 5000;  // points from which the position follows
const SHARE_INSIDE = 0.9;  // of the points, within the picture
const OUTER = 0.05;  // share of the points beyond each side of those that the target is in the middle of
const LEAST_DISTANCE_M = 4;
const FARTHEST = 2;  // distance of the target from the origin, in extents; farther scans are in the frame of a map

function multiply(a, b) {  // of 4 × 4 matrices, column by column
  return Float32Array.from({ length: 16 }, (_, i) =>
    [0, 1, 2, 3].reduce((sum, k) => sum + a[(i & 3) + 4 * k] * b[k + (i & 12)], 0));
}

function dot(a, b) {
  return a.reduce((sum, value, i) => sum + value * b[i], 0);
}

function quantile(values, share) {
  const sorted = Float64Array.from(values).sort();
  return sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))] ?? 0;
}

function sampledPoints({ low, step, position, shown }) {  // x, y, z in metres of evenly spaced points
  const every = Math.max(1, Math.floor(shown / SAMPLED));
  const points = [];
  for (let i = 0; i < shown; i += every) {
    points.push([0, 1, 2].map(axis => low[axis] + step[axis] * position[3 * i + axis]));
  }
  return points;
}

export function fitted(cloud, aspect) {  // azimuth, elevation, target and distance for a scan
  const points = sampledPoints(cloud);
  const along = axis => points.map(point => point[axis]);
  const sides = [0, 1].map(axis => [quantile(along(axis), OUTER), quantile(along(axis), 1 - OUTER)]);
  const target = [...sides.map(([low, high]) => (low + high) / 2), quantile(along(2), 0.5)];
  const extent = Math.max(...sides.map(([low, high]) => high - low));
  const isOneSided = sides.some(([low, high]) => low > 0 || high < 0);  // the points lie in one direction of the origin
  const isNear = Math.hypot(target[0], target[1]) < FARTHEST * extent;
  const towards = Math.atan2(target[1], target[0]) * 180 / Math.PI + 180;
  const azimuth = isOneSided && isNear ? towards : START.azimuth;
  const camera = { ...START, azimuth, target };
  const axes = axesOf(camera);
  const needed = points.map(point => {  // distance from which a point is just within the picture
    const offset = point.map((value, axis) => value - target[axis]);
    const [right, up, back] = axes.map(axis => dot(axis, offset));
    return back + FOCAL * Math.max(Math.abs(right) / aspect, Math.abs(up));
  });
  return { ...camera, distance: Math.max(LEAST_DISTANCE_M, quantile(needed, SHARE_INSIDE)) };
}

export function axesOf({ azimuth, elevation }) {  // right, up, back
  const a = azimuth * Math.PI / 180;
  const e = elevation * Math.PI / 180;
  const right = [-Math.sin(a), Math.cos(a), 0];
  const up = [-Math.cos(a) * Math.sin(e), -Math.sin(a) * Math.sin(e), Math.cos(e)];
  const back = [Math.cos(a) * Math.cos(e), Math.sin(a) * Math.cos(e), Math.sin(e)];
  return [right, up, back];
}

export function matrixOf(camera, aspect) {  // projection times view, column by column
  const axes = axesOf(camera);
  const eye = camera.target.map((value, i) => value + camera.distance * axes[2][i]);
  const rotation = [0, 1, 2].flatMap(column => [...axes.map(axis => axis[column]), 0]);
  const shift = [...axes.map(axis => -dot(axis, eye)), 1];
  const near = Math.max(NEAR_M, camera.distance / 200);
  const depth = 1 / (near - FAR_M);
  const projection = [
    FOCAL / aspect, 0, 0, 0,
    0, FOCAL, 0, 0,
    0, 0, (FAR_M + near) * depth, -1,
    0, 0, 2 * FAR_M * near * depth, 0,
  ];
  return multiply(projection, [...rotation, ...shift]);
}

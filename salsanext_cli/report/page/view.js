"use strict";
// SPDX-License-Identifier: MIT
// Points in three dimensions, drawn with WebGL 2 by a camera that turns around a target.

const VERTEX = `#version 300 es
in vec3 position;
in float colour;
in float shown;
uniform mat4 camera;
uniform vec3 low, step_m;
uniform float size, ring;
uniform int row;
uniform sampler2D palette;
out vec3 rgb;
void main() {
  gl_Position = shown > 0.0 ? camera * vec4(low + step_m * position, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
  gl_PointSize = ring > 0.0 ? ring : size * clamp(25.0 / gl_Position.w, 0.7, 3.0);
  rgb = texelFetch(palette, ivec2(int(colour), row), 0).rgb;
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 rgb;
uniform float ring;
out vec4 pixel;
void main() {
  pixel = vec4(rgb, 1.0);
  if (ring > 0.0) {
    float radius = length(gl_PointCoord - 0.5);
    if (radius > 0.5 || radius < 0.32) discard;
    pixel = vec4(1.0);
  }
}`;
const START = { azimuth: 180, elevation: 32, distance: 42 };  // degrees, metres: looking forward
const NEAR_M = 0.3, FAR_M = 20000, FIELD_OF_VIEW = 50;
const EDGES = [0, 1, 1, 3, 3, 2, 2, 0, 4, 5, 5, 7, 7, 6, 6, 4, 0, 4, 1, 5, 2, 6, 3, 7];  // pairs of corners of a box
const REACH_PX = 7;  // farthest distance of a picked point from the pointer

function multiply(a, b) {  // of 4 × 4 matrices, column by column
  return Float32Array.from({ length: 16 }, (_, i) =>
    [0, 1, 2, 3].reduce((sum, k) => sum + a[(i & 3) + 4 * k] * b[k + (i & 12)], 0));
}

class PointView {
  constructor(canvas) {
    this.canvas = canvas;
    this.gl = canvas.getContext("webgl2", { antialias: false });
    if (!this.gl) throw new Error("no WebGL 2");
    this.size = 2;
    this.marked = -1;
    this.count = this.corners = 0;
    this.home();
    this.prepare();
    new ResizeObserver(() => this.redraw()).observe(canvas);
  }

  prepare() {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    gl.useProgram(program);
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(0.07, 0.082, 0.102, 1);
    this.uniform = Object.fromEntries(["camera", "low", "step_m", "size", "ring", "row"].map(
      name => [name, gl.getUniformLocation(program, name)]));
    this.buffers = {};
    for (const [name, parts, type] of [["position", 3, gl.UNSIGNED_SHORT], ["colour", 1, gl.UNSIGNED_BYTE],
      ["shown", 1, gl.UNSIGNED_BYTE]]) {
      const place = gl.getAttribLocation(program, name);
      this.buffers[name] = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[name]);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, parts, type, false, 0, 0);
    }
    this.lines = gl.createVertexArray();
    gl.bindVertexArray(this.lines);
    gl.vertexAttrib1f(gl.getAttribLocation(program, "shown"), 1);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers.lines = gl.createBuffer());
    for (const [name, parts, start] of [["position", 3, 0], ["colour", 1, 12]]) {
      gl.enableVertexAttribArray(gl.getAttribLocation(program, name));
      gl.vertexAttribPointer(gl.getAttribLocation(program, name), parts, gl.FLOAT, false, 16, start);
    }
    gl.bindVertexArray(null);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, gl.NEAREST);
  }

  upload(name, values) {
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, this.buffers[name]);
    this.gl.bufferData(this.gl.ARRAY_BUFFER, values, this.gl.STATIC_DRAW);
    this.redraw();
  }

  show(cloud) {  // { shown, low, step, position: Uint16Array }
    Object.assign(this, { cloud, count: cloud.shown, marked: -1 });
    this.upload("position", cloud.position);
  }

  colour(values, palettes) {  // a byte per point; 256 colours of 4 bytes for points, then as many for boxes
    const gl = this.gl;
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, 2, 0, gl.RGBA, gl.UNSIGNED_BYTE, palettes);
    this.upload("colour", values);
  }

  filter(visible) {  // 1 or 0 per point
    this.visible = visible;
    this.upload("shown", visible);
  }

  outline(boxes) {  // colour, centre x, y, z, length, width, height and yaw of every box
    const corners = boxes.flatMap(([colour, x, y, z, length, width, height, yaw]) => EDGES.flatMap(corner => {
      const [a, b, c] = [length, width, height].map((size, axis) => (corner >> axis & 1 ? 0.5 : -0.5) * size);
      return [x + a * Math.cos(yaw) - b * Math.sin(yaw), y + a * Math.sin(yaw) + b * Math.cos(yaw), z + c, colour];
    }));
    this.corners = corners.length / 4;
    this.upload("lines", Float32Array.from(corners));
  }

  home() {
    Object.assign(this, START, { target: [0, 0, 0] });
    this.redraw();
  }

  axes() {  // of the camera: right, up, back
    const a = this.azimuth * Math.PI / 180, e = this.elevation * Math.PI / 180;
    const back = [Math.cos(a) * Math.cos(e), Math.sin(a) * Math.cos(e), Math.sin(e)];
    const right = [-Math.sin(a), Math.cos(a), 0];
    const up = [-Math.cos(a) * Math.sin(e), -Math.sin(a) * Math.sin(e), Math.cos(e)];
    return [right, up, back];
  }

  matrix() {
    const axes = this.axes(), eye = this.target.map((t, i) => t + this.distance * axes[2][i]);
    const turned = [0, 1, 2, 3].flatMap(column => column < 3 ? [...axes.map(axis => axis[column]), 0]
      : [...axes.map(axis => -axis.reduce((sum, each, i) => sum + each * eye[i], 0)), 1]);
    const near = Math.max(NEAR_M, this.distance / 200), focal = 1 / Math.tan(FIELD_OF_VIEW * Math.PI / 360);
    const aspect = this.canvas.clientWidth / Math.max(1, this.canvas.clientHeight);
    const depth = 1 / (near - FAR_M);
    return multiply([focal / aspect, 0, 0, 0, 0, focal, 0, 0, 0, 0, (FAR_M + near) * depth, -1,
      0, 0, 2 * FAR_M * near * depth, 0], turned);
  }

  redraw() {
    this.pending ??= requestAnimationFrame(() => this.draw());
  }

  draw() {
    this.pending = undefined;
    const gl = this.gl, canvas = this.canvas, ratio = Math.min(devicePixelRatio || 1, 2);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map(n => Math.max(1, Math.round(n * ratio)));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    gl.viewport(0, 0, width, height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (!this.count || !this.visible) return;
    gl.uniformMatrix4fv(this.uniform.camera, false, this.matrix());
    gl.uniform3fv(this.uniform.low, this.cloud.low);
    gl.uniform3fv(this.uniform.step_m, this.cloud.step);
    gl.uniform1f(this.uniform.size, this.size * ratio);
    gl.uniform1f(this.uniform.ring, 0);
    gl.uniform1i(this.uniform.row, 0);
    gl.drawArrays(gl.POINTS, 0, this.count);
    if (this.marked >= 0) {
      gl.disable(gl.DEPTH_TEST);
      gl.uniform1f(this.uniform.ring, 18 * ratio);
      gl.drawArrays(gl.POINTS, this.marked, 1);
      gl.uniform1f(this.uniform.ring, 0);
      gl.enable(gl.DEPTH_TEST);
    }
    gl.bindVertexArray(this.lines);
    gl.uniform3f(this.uniform.low, 0, 0, 0);  // in metres
    gl.uniform3f(this.uniform.step_m, 1, 1, 1);
    gl.uniform1i(this.uniform.row, 1);
    gl.drawArrays(gl.LINES, 0, this.corners);
    gl.bindVertexArray(null);
  }

  place(index) {  // x, y, z in metres
    const { low, step, position } = this.cloud;
    return [0, 1, 2].map(axis => low[axis] + step[axis] * position[3 * index + axis]);
  }

  pick(x, y) {  // the nearest visible point at a position on the canvas, CSS pixels; -1 without one
    if (!this.cloud) return -1;
    const m = this.matrix(), { low, step, position } = this.cloud, { clientWidth, clientHeight } = this.canvas;
    const [s, t] = [2 * x / clientWidth - 1, 1 - 2 * y / clientHeight];
    const [across, down] = [clientWidth / 2, clientHeight / 2];
    let best = -1, least = Infinity;
    for (let i = 0; i < this.count; i++) {
      if (!this.visible[i]) continue;
      const px = low[0] + step[0] * position[3 * i], py = low[1] + step[1] * position[3 * i + 1],
        pz = low[2] + step[2] * position[3 * i + 2];
      const w = m[3] * px + m[7] * py + m[11] * pz + m[15];
      if (w < NEAR_M) continue;
      const dx = ((m[0] * px + m[4] * py + m[8] * pz + m[12]) / w - s) * across;
      const dy = ((m[1] * px + m[5] * py + m[9] * pz + m[13]) / w - t) * down;
      const far = dx * dx + dy * dy;
      // Prefer the point in front among points about as near to the pointer.
      if (far < REACH_PX * REACH_PX && far + w < least) [best, least] = [i, far + w];
    }
    return best;
  }

  mark(index) {
    this.marked = index;
    this.redraw();
  }

  turn(across, down) {
    this.azimuth -= across;
    this.elevation = Math.min(89.9, Math.max(-89.9, this.elevation + down));
    this.redraw();
  }

  zoom(factor) {
    this.distance = Math.min(3000, Math.max(0.5, this.distance * factor));
    this.redraw();
  }

  move(across, down) {  // in CSS pixels
    const [right, up] = this.axes(), metres = this.distance * 0.93 / Math.max(1, this.canvas.clientHeight);
    this.target = this.target.map((t, i) => t + metres * (down * up[i] - across * right[i]));
    this.redraw();
  }
}

function steer(view, pointed) {  // by mouse, fingers and keys; calls `pointed` with the position of the pointer
  const canvas = view.canvas, pointers = new Map();
  const spread = () => {
    const [a, b] = [...pointers.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, apart: Math.hypot(a.x - b.x, a.y - b.y) };
  };
  const at = event => ({ x: event.offsetX, y: event.offsetY });
  canvas.addEventListener("pointerdown", event => {
    if (event.isTrusted) canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, at(event));
    if (event.pointerType === "touch") pointed(at(event));
  });
  canvas.addEventListener("pointermove", event => {
    const before = pointers.get(event.pointerId);
    if (!before) return pointed(at(event));
    const two = pointers.size === 2, old = two && spread();
    pointers.set(event.pointerId, at(event));
    const now = pointers.get(event.pointerId);
    if (two) {
      const next = spread();
      view.zoom(old.apart / Math.max(1, next.apart));
      view.move(next.x - old.x, next.y - old.y);
    } else if (event.buttons & 2 || event.shiftKey) view.move(now.x - before.x, now.y - before.y);
    else view.turn((now.x - before.x) * 0.3, (now.y - before.y) * 0.3);
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, event => pointers.delete(event.pointerId));
  }
  canvas.addEventListener("pointerleave", () => pointers.size || pointed(null));
  canvas.addEventListener("contextmenu", event => event.preventDefault());
  canvas.addEventListener("wheel", event => {
    event.preventDefault();
    view.zoom(Math.exp(Math.max(-1, Math.min(1, event.deltaY / 400))));
  }, { passive: false });
  const keys = {
    ArrowLeft: () => view.turn(-5, 0), ArrowRight: () => view.turn(5, 0),
    ArrowUp: () => view.turn(0, 5), ArrowDown: () => view.turn(0, -5),
    "+": () => view.zoom(0.85), "=": () => view.zoom(0.85), "-": () => view.zoom(1 / 0.85),
    Home: () => view.home(),
  };
  canvas.addEventListener("keydown", event => {
    if (!keys[event.key] || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    keys[event.key]();
  });
}

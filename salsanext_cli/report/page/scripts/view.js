// SPDX-License-Identifier: MIT
// Points in three dimensions, drawn with WebGL 2 once, or twice in two colourings beside each other.

import { axesOf, fitted, matrixOf, NEAR_M, START } from "./camera.js";

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
  rgb = shown > 1.5 ? vec3(0.23, 0.25, 0.28) : texelFetch(palette, ivec2(int(colour), row), 0).rgb;
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
const EDGES = [0, 1, 1, 3, 3, 2, 2, 0, 4, 5, 5, 7, 7, 6, 6, 4, 0, 4, 1, 5, 2, 6, 3, 7];  // pairs of corners of a box
const WIDE_PX = 700;  // a narrower canvas shows its two panes below each other
const ROWS = { colour: 0, beside: 2 };  // of the palettes; row 1 has the colours of boxes
const REACH_PX = 7;  // farthest distance of a picked point from the pointer

export class PointView {
  constructor(canvas) {
    this.canvas = canvas;
    this.gl = canvas.getContext("webgl2", { antialias: false });
    if (!this.gl) throw new Error("no WebGL 2");
    this.size = 2;
    this.marked = -1;
    this.count = 0;  // of points
    this.corners = 0;  // of boxes
    this.panes = ["colour"];
    Object.assign(this, START, { target: [0, 0, 0], distance: 42 });
    this.prepare();
    new ResizeObserver(() => this.redraw()).observe(canvas);
  }

  prepare() {
    const { gl } = this;
    const program = this.compile();
    gl.useProgram(program);
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(0.07, 0.082, 0.102, 1);
    this.uniform = Object.fromEntries(["camera", "low", "step_m", "size", "ring", "row"].map(
      name => [name, gl.getUniformLocation(program, name)]));
    this.buffers = {};
    for (const name of ["position", "colour", "beside", "shown"]) this.buffers[name] = gl.createBuffer();
    this.colourPlace = gl.getAttribLocation(program, "colour");
    for (const [name, parts, type] of [["position", 3, gl.UNSIGNED_SHORT], ["shown", 1, gl.UNSIGNED_BYTE]]) {
      const place = gl.getAttribLocation(program, name);
      gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[name]);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, parts, type, false, 0, 0);
    }
    gl.enableVertexAttribArray(this.colourPlace);
    this.lines = gl.createVertexArray();
    gl.bindVertexArray(this.lines);
    gl.vertexAttrib1f(gl.getAttribLocation(program, "shown"), 1);
    this.buffers.lines = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers.lines);
    for (const [name, parts, start] of [["position", 3, 0], ["colour", 1, 12]]) {
      gl.enableVertexAttribArray(gl.getAttribLocation(program, name));
      gl.vertexAttribPointer(gl.getAttribLocation(program, name), parts, gl.FLOAT, false, 16, start);
    }
    gl.bindVertexArray(null);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, gl.NEAREST);
  }

  compile() {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    return program;
  }

  upload(name, values) {
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, this.buffers[name]);
    this.gl.bufferData(this.gl.ARRAY_BUFFER, values, this.gl.STATIC_DRAW);
    this.redraw();
  }

  show(cloud) {  // { shown, low, step, position: Uint16Array }
    this.cloud = cloud;
    this.count = cloud.shown;
    this.marked = -1;
    this.upload("position", cloud.position);
  }

  colour(values, beside, palettes) {  // bytes per point, `beside` or null; 256 colours of 4 bytes for points, boxes and beside
    const { gl } = this;
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, 3, 0, gl.RGBA, gl.UNSIGNED_BYTE, palettes);
    this.panes = beside ? ["colour", "beside"] : ["colour"];
    if (beside) this.upload("beside", beside);
    this.upload("colour", values);
  }

  filter(visible) {  // per point: 0 hidden, 1 shown, 2 faint
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

  home() {  // where most points are visible
    if (this.cloud) Object.assign(this, fitted(this.cloud, this.aspect()));
    this.redraw();
  }

  pane() {  // number of panes across and down, and their size in CSS pixels
    const { clientWidth, clientHeight } = this.canvas;
    const two = this.panes.length > 1;
    const across = two && clientWidth >= WIDE_PX ? 2 : 1;
    const down = two && across === 1 ? 2 : 1;
    return { across, down, width: clientWidth / across, height: Math.max(1, clientHeight / down) };
  }

  aspect() {
    const { width, height } = this.pane();
    return Math.max(0.1, width / height);
  }

  matrix() {
    return matrixOf(this, this.aspect());
  }

  redraw() {
    this.pending ??= requestAnimationFrame(() => this.draw());
  }

  draw() {
    this.pending = undefined;
    const { gl, canvas } = this;
    const ratio = Math.min(devicePixelRatio || 1, 2);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map(n => Math.max(1, Math.round(n * ratio)));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    gl.disable(gl.SCISSOR_TEST);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (!this.count || !this.visible) return;
    gl.enable(gl.SCISSOR_TEST);
    gl.uniformMatrix4fv(this.uniform.camera, false, this.matrix());
    const { across, down } = this.pane();
    const paneWidth = Math.floor(width / across);
    const paneHeight = Math.floor(height / down);
    this.panes.forEach((name, i) => {
      const left = across > 1 ? i * paneWidth : 0;
      const bottom = down > 1 ? (1 - i) * paneHeight : 0;
      gl.viewport(left, bottom, paneWidth, paneHeight);
      gl.scissor(left, bottom, paneWidth, paneHeight);
      this.drawPane(name, ratio);
    });
  }

  drawPane(name, ratio) {
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[name]);
    gl.vertexAttribPointer(this.colourPlace, 1, gl.UNSIGNED_BYTE, false, 0, 0);
    gl.uniform3fv(this.uniform.low, this.cloud.low);
    gl.uniform3fv(this.uniform.step_m, this.cloud.step);
    gl.uniform1f(this.uniform.size, this.size * ratio);
    gl.uniform1f(this.uniform.ring, 0);
    gl.uniform1i(this.uniform.row, ROWS[name]);
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
    const m = this.matrix();
    const { low, step, position } = this.cloud;
    const { width, height } = this.pane();
    const s = 2 * (x % width) / width - 1;
    const t = 1 - 2 * (y % height) / height;
    let best = -1;
    let least = Infinity;
    for (let i = 0; i < this.count; i++) {
      if (this.visible[i] !== 1) continue;
      const px = low[0] + step[0] * position[3 * i];
      const py = low[1] + step[1] * position[3 * i + 1];
      const pz = low[2] + step[2] * position[3 * i + 2];
      const w = m[3] * px + m[7] * py + m[11] * pz + m[15];
      if (w < NEAR_M) continue;
      const dx = ((m[0] * px + m[4] * py + m[8] * pz + m[12]) / w - s) * width / 2;
      const dy = ((m[1] * px + m[5] * py + m[9] * pz + m[13]) / w - t) * height / 2;
      const far = dx * dx + dy * dy;
      // Prefer the point in front among points about as near to the pointer.
      if (far < REACH_PX * REACH_PX && far + w < least) {
        best = i;
        least = far + w;
      }
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
    const [right, up] = axesOf(this);
    const metres = this.distance * 0.93 / this.pane().height;
    this.target = this.target.map((t, i) => t + metres * (down * up[i] - across * right[i]));
    this.redraw();
  }
}

export function steer(view, pointed) {  // by mouse, fingers and keys; calls `pointed` with the position of the pointer
  const { canvas } = view;
  const pointers = new Map();
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
    const now = at(event);
    if (!before) {
      pointed(now);
      return;
    }
    const old = pointers.size === 2 ? spread() : null;
    pointers.set(event.pointerId, now);
    if (old) {
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

// SPDX-License-Identifier: MIT
// The drive, one column per scan: curves of mean uncertainty and wrong points above shares of classes.

import { JUDGED, percentOf, title } from "./data.js";
import { roundMarks } from "./scales.js";

const UNCERTAIN_COLOUR = "#2f7fd0";
const WRONG_COLOUR = "#e0482e";
const CURVE_PX = 126;  // height of the curves with their legend
const HEAD_PX = 34;  // height of this legend
const LINE_PX = 15;  // height of an entry of it, one per curve
const GAP_PX = 20;  // between curves and shares
const NAMES_PX = 18;  // height of the names of sequences
const LEFT_PX = 46;
const RIGHT_PX = 46;
const STEPS = { ArrowLeft: -1, ArrowRight: 1, PageUp: -50, PageDown: 50, Home: -Infinity, End: Infinity };  // scans by key

export class DriveView {
  // scans: { count, names, sequences, shown: index in the page or -1, marked: whether worth a look, shares: (count × classes), uncertainty, wrong, kind }
  constructor(canvas, caption, scans, classes, open) {
    this.canvas = canvas;
    this.caption = caption;
    this.scans = scans;
    this.classes = classes;
    this.open = open;
    this.at = Math.max(0, scans.shown.findIndex(i => i >= 0));
    this.isShare = scans.is_share;  // as the share of wrong points is
    new ResizeObserver(() => this.draw()).observe(canvas);
    canvas.addEventListener("pointermove", event => this.point(this.place(event.offsetX)));
    canvas.addEventListener("click", event => this.choose(this.nearest(this.place(event.offsetX), event.offsetX)));
    canvas.addEventListener("focus", () => this.point(this.at));
    canvas.addEventListener("keydown", event => {
      const step = STEPS[event.key];
      if (event.key === "Enter" || event.key === " ") this.choose(this.at);
      else if (step) this.point(Math.min(scans.count - 1, Math.max(0, this.at + step)));
      else return;
      event.preventDefault();
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  per() {  // pixels of a column
    return Math.max(1, this.canvas.clientWidth - LEFT_PX - RIGHT_PX) / this.scans.count;
  }

  place(x) {
    return Math.min(this.scans.count - 1, Math.max(0, Math.floor((x - LEFT_PX) / this.per())));
  }

  nearest(place, x) {  // the mark under the pointer, wider than a column among thousands
    const per = this.per();
    const distance = marked => Math.abs(LEFT_PX + (marked + 0.5) * per - x);
    const marked = [...this.scans.marked.keys()].filter(i => this.scans.marked[i]);
    const [best] = marked.sort((a, b) => distance(a) - distance(b));
    return best !== undefined && distance(best) < Math.max(6, per / 2) ? best : place;
  }

  point(place) {
    this.at = place;
    this.draw();
    const { names, uncertainty, wrong, kind } = this.scans;
    const isKnown = values => values && !Number.isNaN(values[place]);
    const parts = [names[place]];
    if (isKnown(uncertainty)) {
      const mean = uncertainty[place];
      parts.push(`mean ${title(kind)} ${this.isShare ? percentOf(mean) : mean.toPrecision(3)}`);
    }
    if (isKnown(wrong)) parts.push(`${percentOf(wrong[place])} of the ${JUDGED} wrong`);
    parts.push(this.largest(place));
    this.caption.textContent = parts.join(" · ");
  }

  largest(place) {  // the three largest classes of a scan in words
    const { shares } = this.scans;
    if (!shares) return "";
    const share = id => shares[place * this.classes.length + id];
    const ids = [...this.classes.keys()].sort((a, b) => share(b) - share(a));
    return ids.slice(0, 3).map(id => `${this.classes[id].name} ${(100 * share(id)).toFixed(0)} %`).join(", ");
  }

  choose(place) {
    this.point(place);
    if (this.scans.shown[place] >= 0) this.open(this.scans.shown[place]);
    else this.caption.textContent += ` · not in this page: run report with --scans ${this.scans.names[place]}`;
  }

  curves() {  // with their marks: shares have a common axis, another uncertainty an axis of its own
    const { uncertainty, wrong, kind } = this.scans;
    const most = values => values ? values.reduce((largest, value) => Math.max(largest, value || 0), 0) : 0;
    const shareMarks = roundMarks(Math.max(most(wrong), this.isShare ? most(uncertainty) : 0));
    const percent = mark => `${+(100 * mark).toPrecision(3)} %`;
    let sideOfWrong = "left";
    if (uncertainty) sideOfWrong = this.isShare ? "" : "right";
    const curves = [
      {
        values: uncertainty,
        name: `mean ${title(kind)}`,
        colour: UNCERTAIN_COLOUR,
        marks: this.isShare ? shareMarks : roundMarks(most(uncertainty)),
        text: this.isShare ? percent : String,
        side: "left",
      },
      {
        values: wrong,
        name: `wrong, of the ${JUDGED}`,
        colour: WRONG_COLOUR,
        marks: shareMarks,
        text: percent,
        side: sideOfWrong,
      },
    ];
    return curves.filter(({ values }) => most(values) > 0);
  }

  draw() {
    const { canvas, scans } = this;
    const ratio = Math.min(devicePixelRatio || 1, 2);
    const width = canvas.clientWidth;
    const height = canvas.clientHeight;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const pen = canvas.getContext("2d");
    const ink = getComputedStyle(document.body).color;
    pen.scale(ratio, ratio);
    pen.font = "12px system-ui, sans-serif";
    const per = this.per();
    const middle = place => LEFT_PX + (place + 0.5) * per;
    for (const [line, curve] of this.curves().entries()) {
      this.axis(pen, curve, width);
      this.curve(pen, curve, middle);
      this.entry(pen, curve, line);
    }
    const top = CURVE_PX + GAP_PX;
    const bottom = height - NAMES_PX;
    this.shares(pen, top, bottom);
    this.sequences(pen, top, bottom, middle);
    pen.fillStyle = ink;
    pen.textAlign = "center";
    scans.marked.forEach((isMarked, place) => {
      if (isMarked) pen.fillText("▾", middle(place), top - 4);
    });
    pen.strokeStyle = ink;
    pen.strokeRect(middle(this.at) - Math.max(3, per / 2), top - 1, Math.max(6, per), bottom - top + 1);
  }

  entry(pen, { name, colour }, line) {  // of the legend
    pen.fillStyle = colour;
    pen.fillRect(LEFT_PX, 5 + LINE_PX * line, 12, 3);
    pen.fillStyle = this.faint();
    pen.textAlign = "left";
    pen.fillText(name, LEFT_PX + 17, 11 + LINE_PX * line);
  }

  faint() {
    return getComputedStyle(document.body).getPropertyValue("--faint");
  }

  axis(pen, { marks, text, side }, width) {
    if (!side) return;
    pen.fillStyle = this.faint();
    pen.strokeStyle = getComputedStyle(document.body).getPropertyValue("--line");
    pen.textAlign = side === "left" ? "right" : "left";
    for (const mark of marks) {
      const y = this.height(mark, marks);
      pen.fillText(text(mark), side === "left" ? LEFT_PX - 6 : width - RIGHT_PX + 6, y + 4);
      pen.beginPath();
      pen.moveTo(LEFT_PX, y);
      pen.lineTo(width - RIGHT_PX, y);
      pen.stroke();
    }
  }

  height(value, marks) {
    return CURVE_PX - value / marks[marks.length - 1] * (CURVE_PX - HEAD_PX - 6);
  }

  curve(pen, { values, colour, marks }, middle) {
    pen.strokeStyle = colour;
    pen.lineWidth = 1.5;
    pen.beginPath();
    let isDrawing = false;
    values.forEach((value, place) => {
      const x = middle(place);
      const y = this.height(value, marks);
      if (Number.isNaN(value)) {
        isDrawing = false;
        return;
      }
      if (!isDrawing) pen.moveTo(x - 2, y);
      pen.lineTo(x, y);
      isDrawing = true;
    });
    pen.stroke();
    pen.lineWidth = 1;
  }

  shares(pen, top, bottom) {
    const { count, shares } = this.scans;
    if (!shares) return;
    const per = this.per();
    const width = Math.max(1, per > 6 ? per - 1 : per);
    const step = Math.ceil(1 / per);  // the first scan of every pixel
    for (let place = 0; place < count; place += step) {
      let base = bottom;
      for (const [id, { css }] of this.classes.entries()) {
        const share = shares[place * this.classes.length + id] * (bottom - top);
        pen.fillStyle = css;
        pen.fillRect(LEFT_PX + place * per, base - share, width, share);
        base -= share;
      }
    }
  }

  sequences(pen, top, bottom, middle) {  // their names, and lines between them
    pen.fillStyle = this.faint();
    pen.textAlign = "left";
    let free = 0;
    this.scans.sequences.forEach((name, place, names) => {
      if (name === names[place - 1]) return;
      const x = middle(place) - this.per() / 2;
      pen.fillRect(x, top, 1, bottom - top + 5);
      if (x < free) return;
      pen.fillText(name, x + 3, bottom + 14);
      free = x + pen.measureText(name).width + 12;
    });
  }
}

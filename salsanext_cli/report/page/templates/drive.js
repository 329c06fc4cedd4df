// SPDX-License-Identifier: MIT
// The drive, one column per scan: curves of mean uncertainty and wrong points above shares of classes.

const CURVE_PX = 126, GAP_PX = 20, NAMES_PX = 18, UNCERTAIN_COLOUR = "#2f7fd0", WRONG_COLOUR = "#e0482e";
const LEFT_PX = 46, RIGHT_PX = 46, HEAD_PX = 34, LINE_PX = 15;  // one line of the legend per curve

class DriveView {
  // scans: { count, names, sequences, shown: index in the page or -1, marked: whether worth a look, shares: (count × classes), uncertainty, wrong, kind }
  constructor(canvas, caption, scans, classes, open) {
    Object.assign(this, { canvas, caption, scans, classes, open, at: Math.max(0, scans.shown.findIndex(i => i >= 0)) });
    this.isShare = scans.is_share;  // as the share of wrong points is
    new ResizeObserver(() => this.draw()).observe(canvas);
    canvas.addEventListener("pointermove", event => this.point(this.place(event.offsetX)));
    canvas.addEventListener("click", event => this.choose(this.nearest(this.place(event.offsetX), event.offsetX)));
    canvas.addEventListener("focus", () => this.point(this.at));
    canvas.addEventListener("keydown", event => {
      const step = { ArrowLeft: -1, ArrowRight: 1, PageUp: -50, PageDown: 50, Home: -Infinity, End: Infinity }[event.key];
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
    const marked = this.scans.marked.flatMap((is, i) => !is ? [] : [[Math.abs(LEFT_PX + (i + 0.5) * per - x), i]]);
    const [far, best] = marked.sort((a, b) => a[0] - b[0])[0] ?? [Infinity, place];
    return far < Math.max(6, per / 2) ? best : place;
  }

  point(place) {
    this.at = place;
    this.draw();
    const { names, uncertainty, wrong, kind } = this.scans;
    const value = (values, text) => values && !Number.isNaN(values[place]) ? text(values[place]) : "";
    this.caption.textContent = names[place] + value(uncertainty, v => ` · mean ${title(kind)} ${this.isShare ? percentOf(v) : v.toPrecision(3)}`)
      + value(wrong, v => ` · ${(100 * v).toFixed(1)} % of the ${JUDGED} wrong`) + ` · ${this.largest(place)}`;
  }

  largest(place) {
    const { shares } = this.scans, size = this.classes.length;
    if (!shares) return "";
    const named = this.classes.map(({ name }, i) => [shares[place * size + i], name]);
    return named.sort((a, b) => b[0] - a[0]).slice(0, 3).map(([s, name]) => `${name} ${(100 * s).toFixed(0)} %`).join(", ");
  }

  choose(place) {
    this.point(place);
    if (this.scans.shown[place] >= 0) this.open(this.scans.shown[place]);
    else this.caption.textContent += ` · not in this page: run report with --scans ${this.scans.names[place]}`;
  }

  curves() {  // with their marks: shares have a common axis, another uncertainty an axis of its own
    const { uncertainty, wrong, kind } = this.scans, most = values => values ? values.reduce((m, v) => Math.max(m, v || 0), 0) : 0;
    const both = Math.max(most(wrong), this.isShare ? most(uncertainty) : 0);
    const percent = mark => `${+(100 * mark).toPrecision(3)} %`, plain = mark => `${mark}`;
    const shares = roundMarks(both), own = this.isShare ? shares : roundMarks(most(uncertainty));
    return [
      { values: uncertainty, name: `mean ${title(kind)}`, colour: UNCERTAIN_COLOUR, marks: own, text: this.isShare ? percent : plain, side: "left" },
      { values: wrong, name: `wrong, of the ${JUDGED}`, colour: WRONG_COLOUR, marks: shares, text: percent, side: this.isShare && uncertainty ? "" : uncertainty ? "right" : "left" },
    ].filter(({ values }) => most(values) > 0);
  }

  draw() {
    const { canvas, scans } = this, ratio = Math.min(devicePixelRatio || 1, 2);
    const width = canvas.clientWidth, height = canvas.clientHeight;
    Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
    const pen = canvas.getContext("2d"), ink = getComputedStyle(document.body).color;
    pen.scale(ratio, ratio);
    pen.font = "12px system-ui, sans-serif";
    const per = this.per(), middle = place => LEFT_PX + (place + 0.5) * per;
    for (const [line, curve] of this.curves().entries()) {
      this.axis(pen, curve, width);
      this.curve(pen, curve, middle);
      this.entry(pen, curve, line);
    }
    const top = CURVE_PX + GAP_PX, bottom = height - NAMES_PX;
    this.shares(pen, top, bottom);
    this.sequences(pen, top, bottom, middle);
    pen.fillStyle = ink;
    pen.textAlign = "center";
    scans.marked.forEach((is, place) => is && pen.fillText("▾", middle(place), top - 4));
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
    let known = false;
    values.forEach((value, place) => {
      const x = middle(place), y = this.height(value, marks);
      if (Number.isNaN(value)) known = false;
      else if (known) pen.lineTo(x, y);
      else { pen.moveTo(x - 2, y); pen.lineTo(x, y); known = true; }
    });
    pen.stroke();
    pen.lineWidth = 1;
  }

  shares(pen, top, bottom) {
    const { scans } = this, per = this.per(), size = this.classes.length;
    const step = Math.ceil(1 / per);  // the first scan of every pixel
    for (let place = 0; place < scans.count && scans.shares; place += step) {
      let base = bottom;
      for (const id of this.classes.keys()) {
        const share = scans.shares[place * size + id] * (bottom - top);
        pen.fillStyle = this.classes[id].css;
        pen.fillRect(LEFT_PX + place * per, base - share, Math.max(1, per - (per > 6 ? 1 : 0)), share);
        base -= share;
      }
    }
  }

  sequences(pen, top, bottom, middle) {  // their names, and lines between them
    pen.fillStyle = pen.strokeStyle = this.faint();
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

// SPDX-License-Identifier: MIT
// The drive, one column per scan: curves of mean uncertainty and wrong points above shares of classes.

const CURVE_PX = 100, GAP_PX = 22, UNCERTAIN_COLOUR = "#2f7fd0", WRONG_COLOUR = "#e0482e";

class DriveView {
  // scans: { count, names, shown: index in the page or -1, marked: whether worth a look, shares: (count × classes), uncertainty, wrong }
  constructor(canvas, caption, scans, classes, open) {
    Object.assign(this, { canvas, caption, scans, classes, open, at: Math.max(0, scans.shown.findIndex(i => i >= 0)) });
    new ResizeObserver(() => this.draw()).observe(canvas);
    const place = x => Math.min(scans.count - 1, Math.max(0, Math.floor(x / canvas.clientWidth * scans.count)));
    canvas.addEventListener("pointermove", event => this.point(place(event.offsetX)));
    canvas.addEventListener("click", event => this.choose(this.nearest(place(event.offsetX), event.offsetX)));
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

  nearest(place, x) {  // the mark under the pointer, wider than a column among thousands
    const per = this.canvas.clientWidth / this.scans.count;
    const marked = this.scans.marked.flatMap((is, i) => !is ? [] : [[Math.abs((i + 0.5) * per - x), i]]);
    const [far, best] = marked.sort((a, b) => a[0] - b[0])[0] ?? [Infinity, place];
    return far < Math.max(6, per / 2) ? best : place;
  }

  point(place) {
    this.at = place;
    this.draw();
    const { names, uncertainty, wrong, kind } = this.scans;
    const value = (values, text) => values && !Number.isNaN(values[place]) ? text(values[place]) : "";
    this.caption.textContent = names[place] + value(uncertainty, v => ` · mean ${kind} ${v.toPrecision(3)}`)
      + value(wrong, v => ` · ${(100 * v).toFixed(1)} % wrong`) + ` · ${this.largest(place)}`;
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

  draw() {
    const { canvas, scans } = this, ratio = Math.min(devicePixelRatio || 1, 2);
    const width = canvas.clientWidth, height = canvas.clientHeight;
    Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
    const pen = canvas.getContext("2d"), style = getComputedStyle(document.body);
    const ink = style.color, faint = style.getPropertyValue("--faint");
    pen.scale(ratio, ratio);
    pen.font = "12px system-ui, sans-serif";
    const per = width / scans.count, middle = place => (place + 0.5) * per;
    this.curve(pen, scans.uncertainty, UNCERTAIN_COLOUR, middle);
    this.curve(pen, scans.wrong, WRONG_COLOUR, middle);
    let left = 0;
    for (const [values, name, colour] of [[scans.uncertainty, `mean ${scans.kind}`, UNCERTAIN_COLOUR],
      [scans.wrong, "wrong", WRONG_COLOUR]]) {
      const most = this.most(values);
      if (!most) continue;
      const text = `${name}, up to ${values === scans.wrong ? `${(100 * most).toFixed(1)} %` : most.toPrecision(3)}`;
      pen.fillStyle = colour;
      pen.fillRect(left, 5, 12, 3);
      pen.fillStyle = faint;
      pen.fillText(text, left + 17, 11);
      left += pen.measureText(text).width + 32;
    }
    const top = CURVE_PX + GAP_PX, size = this.classes.length;
    const step = Math.ceil(scans.count / Math.max(1, width));  // the first scan of every pixel
    for (let place = 0; place < scans.count && scans.shares; place += step) {
      let bottom = height;
      for (const id of this.classes.keys()) {
        const share = scans.shares[place * size + id] * (height - top);
        pen.fillStyle = this.classes[id].css;
        pen.fillRect(place * per, bottom - share, Math.max(1, per - (per > 6 ? 1 : 0)), share);
        bottom -= share;
      }
    }
    pen.fillStyle = ink;
    scans.marked.forEach((is, place) => is && pen.fillText("▾", middle(place) - 5, top - 5));
    pen.strokeStyle = ink;
    pen.strokeRect(middle(this.at) - Math.max(3, per / 2), top - 1, Math.max(6, per), height - top);
  }

  most(values) {
    return values ? values.reduce((most, value) => Math.max(most, value || 0), 0) : 0;
  }

  curve(pen, values, colour, middle) {
    const most = this.most(values);
    if (!most) return;
    pen.strokeStyle = colour;
    pen.lineWidth = 1.5;
    pen.beginPath();
    let known = false;
    values.forEach((value, place) => {
      const x = middle(place), y = CURVE_PX - value / most * (CURVE_PX - 22);
      if (Number.isNaN(value)) known = false;
      else if (known) pen.lineTo(x, y);
      else { pen.moveTo(x - 2, y); pen.lineTo(x, y); known = true; }
    });
    pen.stroke();
    pen.lineWidth = 1;
  }
}

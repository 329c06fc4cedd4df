// SPDX-License-Identifier: MIT
// The table of scans: sorted by any column, with thumbnails, and tags that can be saved as a list for `salsanext pick`.

import { byId, JUDGED, percentOf, title } from "./data.js";

const ROWS_AT_ONCE = 12;
export const MORE_ROWS = 5 * ROWS_AT_ONCE;
const LIST_NAME = "tagged.txt";
const THUMBNAIL_PX = 64;

function precise(value) {
  return Number.isNaN(value) ? "–" : value.toPrecision(3);
}

function numbers(values, text) {  // of a column, the largest first
  return { value: place => values[place], text: place => text(values[place]), down: true };
}

export class ScanTable {
  // scans: as of the drive, with points, codes, thumbnails, doubtful and rejected
  // open: opens a scan; changed: called after a change of the tags; largest: the classes of a scan in words
  constructor(box, scans, { open, changed, largest }) {
    this.box = box;
    this.scans = scans;
    this.open = open;
    this.changed = changed;
    this.tags = new Set();
    this.rows = ROWS_AT_ONCE;
    this.columns = this.columnsOf(scans, largest);
    this.sorted = this.columns.find(({ name }) => name.startsWith("mean ")) ?? this.columns[2];
    this.descending = Boolean(this.sorted.down);
    this.draw();
  }

  columnsOf(scans, largest) {  // a column without `value` cannot be sorted by
    const { shares, uncertainty, doubtful, wrong, rejected, codes, points } = scans;
    const included = rejected ? ", rejected ones included" : "";
    const columns = [
      { name: "tag", value: place => +this.tags.has(scans.names[place]), down: true },
      { name: shares ? "from above, by class" : "from above", picture: true },
      { name: "scan", value: place => place, text: place => scans.names[place] },
    ];
    if (uncertainty) columns.push({ name: `mean ${title(scans.kind)}`, ...numbers(uncertainty, scans.is_share ? percentOf : precise) });
    if (doubtful) columns.push({ name: `error above 10 %, of points with a label${included}`, ...numbers(doubtful, percentOf) });
    if (wrong) columns.push({ name: `wrong, of the ${JUDGED}`, ...numbers(wrong, percentOf) });
    if (rejected) columns.push({ name: "rejected, of points with a label", ...numbers(rejected, percentOf) });
    if (codes.some(ofScan => ofScan.length)) {
      columns.push({ name: "warnings", value: place => codes[place].length, text: place => codes[place].join(", "), down: true });
    }
    columns.push({ name: "points", ...numbers(points, value => value.toLocaleString("en")), minor: true });
    if (shares) columns.push({ name: "largest classes", text: largest, minor: true });
    return columns;
  }

  order() {  // unknown values come last
    const { value } = this.sorted;
    const sign = this.descending ? -1 : 1;
    const rank = place => Number.isNaN(value(place)) ? Infinity : sign * value(place);
    return [...this.scans.names.keys()].sort((a, b) => rank(a) - rank(b) || a - b);
  }

  draw() {
    const table = document.createElement("table");
    const head = table.createTHead().insertRow();
    head.append(...this.columns.map(column => this.heading(column)));
    const body = table.createTBody();
    for (const place of this.order().slice(0, this.rows)) this.fillRow(body.insertRow(), place);
    this.box.replaceChildren(table);
    byId("more").hidden = this.rows >= this.scans.count;
    this.count();
  }

  showMore(rows) {
    this.rows += rows;
    this.draw();
  }

  heading(column) {
    const cell = document.createElement("th");
    cell.className = column.minor ? "minor" : "";
    if (!column.value) {
      cell.textContent = column.name;
      return cell;
    }
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = column.name;
    button.addEventListener("click", () => this.sort(column));
    if (column === this.sorted) cell.setAttribute("aria-sort", this.descending ? "descending" : "ascending");
    cell.append(button);
    return cell;
  }

  sort(column) {
    this.descending = column === this.sorted ? !this.descending : Boolean(column.down);
    this.sorted = column;
    const place = this.columns.indexOf(column);
    this.draw();
    this.box.querySelectorAll("th")[place].querySelector("button").focus();
  }

  fillRow(row, place) {
    const name = this.scans.names[place];
    const shown = this.scans.shown[place];
    row.dataset.scan = name;
    for (const column of this.columns) {
      const cell = row.insertCell();
      cell.className = column.minor ? "minor" : "";
      if (column.name === "tag") cell.append(this.tagBox(name));
      else if (column.picture) cell.append(...this.picture(place));
      else cell.textContent = column.text(place);
      if (column.name === "scan" && shown >= 0) cell.replaceChildren(this.opener(name, shown));
    }
  }

  tagBox(name) {
    const box = document.createElement("input");
    box.type = "checkbox";
    box.checked = this.tags.has(name);
    box.setAttribute("aria-label", `tag ${name}`);
    box.addEventListener("change", () => this.tag(name, box.checked));
    return box;
  }

  picture(place) {  // a list with the thumbnail, or an empty one
    const address = this.scans.thumbnails[place];
    if (!address) return [];
    const image = document.createElement("img");
    image.src = address;
    image.alt = `${this.scans.names[place]} from above`;
    image.width = THUMBNAIL_PX;
    image.height = THUMBNAIL_PX;
    return [image];
  }

  opener(name, shown) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = name;
    button.addEventListener("click", () => this.open(shown));
    return button;
  }

  tag(name, isTagged) {
    if (isTagged) this.tags.add(name);
    else this.tags.delete(name);
    const row = [...this.box.querySelectorAll("tr")].find(({ dataset }) => dataset.scan === name);
    if (row) row.querySelector("input").checked = isTagged;
    this.count();
    this.changed();
  }

  count() {
    byId("save").disabled = !this.tags.size;
    byId("tagged").textContent = this.tags.size ? `${this.tags.size} tagged` : "none tagged";
    byId("pick").hidden = !this.tags.size;
  }

  list() {  // names of the tagged scans, in the order of the drive
    return this.scans.names.filter(name => this.tags.has(name));
  }

  save() {
    const comment = `# scans tagged in a page of salsanext; for: salsanext pick SCANS tagged/ --from ${LIST_NAME}`;
    const text = `${comment}\n${this.list().join("\n")}\n`;
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type: "text/plain" }));
    link.download = LIST_NAME;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    return text;
  }
}

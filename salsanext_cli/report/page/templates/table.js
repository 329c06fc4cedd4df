// SPDX-License-Identifier: MIT
// The table of scans: sorted by any column, with thumbnails, and tags that can be saved as a list for `salsanext pick`.

const ROWS_AT_ONCE = 12, LIST_NAME = "tagged.txt";
const percentOf = value => Number.isNaN(value) ? "–" : `${(100 * value).toFixed(1)} %`;

class ScanTable {
  // scans: as of the drive, with points, codes, thumbnails, doubtful and rejected; changed: called after a change of the tags
  constructor(box, scans, classes, { open, changed }) {
    Object.assign(this, { box, scans, classes, open, changed, tags: new Set(), rows: ROWS_AT_ONCE });
    const number = (values, text) => ({ value: place => values[place], text: place => text(values[place]), down: true });
    this.columns = [
      { name: "tag", value: place => +this.tags.has(scans.names[place]), down: true },
      { name: scans.shares ? "from above, by class" : "from above", picture: true },
      { name: "scan", value: place => place, text: place => scans.names[place] },
      scans.uncertainty && { name: `mean ${title(scans.kind)}`, ...number(scans.uncertainty, scans.is_share ? percentOf : value => Number.isNaN(value) ? "–" : value.toPrecision(3)) },
      scans.doubtful && { name: `error above 10 %, of points with a label${scans.rejected ? ", rejected ones included" : ""}`, ...number(scans.doubtful, percentOf) },
      scans.wrong && { name: `wrong, of the ${JUDGED}`, ...number(scans.wrong, percentOf) },
      scans.rejected && { name: "rejected, of points with a label", ...number(scans.rejected, percentOf) },
      scans.codes.some(codes => codes.length) && { name: "warnings", value: place => scans.codes[place].length, text: place => scans.codes[place].join(", "), down: true },
      { name: "points", ...number(scans.points, value => value.toLocaleString("en")), minor: true },
      scans.shares && { name: "largest classes", text: place => drive.largest(place), minor: true },
    ].filter(Boolean);
    this.sorted = this.columns.find(({ name }) => name.startsWith("mean ")) ?? this.columns[2];
    this.descending = Boolean(this.sorted.down);
    this.draw();
  }

  order() {  // unknown values come last
    const { value } = this.sorted, sign = this.descending ? -1 : 1;
    const last = v => Number.isNaN(v) ? Infinity : sign * v;
    return [...this.scans.names.keys()].sort((a, b) => last(value(a)) - last(value(b)) || a - b);
  }

  draw() {
    const table = document.createElement("table"), head = table.createTHead().insertRow();
    head.append(...this.columns.map(column => this.heading(column)));
    const body = table.createTBody();
    for (const place of this.order().slice(0, this.rows)) this.row(body.insertRow(), place);
    this.box.replaceChildren(table);
    byId("more").hidden = this.rows >= this.scans.count;
    this.count();
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

  row(row, place) {
    const name = this.scans.names[place], shown = this.scans.shown[place];
    row.dataset.scan = name;
    for (const column of this.columns) {
      const cell = row.insertCell();
      cell.className = column.minor ? "minor" : "";
      if (column.name === "tag") cell.append(this.box_of(name));
      else if (column.picture) cell.append(...this.picture(place));
      else cell.textContent = column.text(place);
      if (column.name === "scan" && shown >= 0) cell.replaceChildren(this.opener(name, shown));
    }
  }

  box_of(name) {  // to tag a scan
    const box = document.createElement("input");
    box.type = "checkbox";
    box.checked = this.tags.has(name);
    box.setAttribute("aria-label", `tag ${name}`);
    box.addEventListener("change", () => this.tag(name, box.checked));
    return box;
  }

  picture(place) {
    const address = this.scans.thumbnails[place];
    if (!address) return [];
    const image = document.createElement("img");
    Object.assign(image, { src: address, alt: `${this.scans.names[place]} from above`, width: 64, height: 64 });
    return [image];
  }

  opener(name, shown) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = name;
    button.addEventListener("click", () => this.open(shown));
    return button;
  }

  tag(name, is) {
    if (is) this.tags.add(name);
    else this.tags.delete(name);
    const row = [...this.box.querySelectorAll("tr")].find(({ dataset }) => dataset.scan === name);
    if (row) row.querySelector("input").checked = is;
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
    const text = `# scans tagged in a page of salsanext; for: salsanext pick SCANS tagged/ --from ${LIST_NAME}\n${this.list().join("\n")}\n`;
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type: "text/plain" }));
    link.download = LIST_NAME;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    return text;
  }
}

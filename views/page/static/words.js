// Text of numbers and times, and elements that hold it.

const NONE = "–";

export const fixed = (value, digits) => (value === null || value === undefined ? NONE : value.toFixed(digits));
export const percent = (ratio, digits = 0) => (ratio === null || ratio === undefined ? NONE : `${(100 * ratio).toFixed(digits)} %`);
export const count = (value) => value.toLocaleString("en").replaceAll(",", "\u202f");
export const clock = (time_s) => new Date(1000 * time_s).toLocaleTimeString("en-GB");
export const clockTenths = (time_s) => `${clock(time_s)}.${Math.floor(10 * time_s) % 10}`;
/** Text of a place in a recording, or of the time that it takes: 1:07.3. */
export function stopwatch(seconds, digits = 0) {
  const rounded = Number(seconds.toFixed(digits)); // 59.97 is 1:00.0
  return `${Math.floor(rounded / 60)}:${(rounded % 60).toFixed(digits).padStart(digits ? 3 + digits : 2, "0")}`;
}
/** Text of a number of millinewtons with three digits or more. */
export const millinewtons = (force_n) => (Math.abs(force_n) < 0.1 ? (1000 * force_n).toFixed(1) : count(Math.round(1000 * force_n)));
export const force = (force_n) => (Math.abs(force_n) < 1 ? `${millinewtons(force_n)} mN` : `${force_n.toFixed(2)} N`);
/** Text of a place in the frame of the skin. */
export const spaced = ([x, y, z]) => `x ${(1000 * x).toFixed(1)}, y ${(1000 * y).toFixed(1)}, z ${(1000 * z).toFixed(1)} mm`;

/** Text of a duration: 0.8 s, 12 s, 3 min, 2 h. */
export function span(seconds) {
  if (seconds < 10) return `${Math.max(0, seconds).toFixed(1)} s`;
  if (seconds < 120) return `${Math.round(seconds)} s`;
  return seconds < 7200 ? `${Math.round(seconds / 60)} min` : `${Math.round(seconds / 3600)} h`;
}

/** Text of a label: golf-ball becomes golf ball. */
export const spoken = (label) => label.replaceAll(/[-_]/g, " ");

/** Write `text` into `element` if it differs: an unchanged element is not repainted. */
export function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Make an element with a class and a text. */
export function make(tag, name = "", text = "") {
  const element = document.createElement(tag);
  if (name) element.className = name;
  if (text) element.textContent = text;
  return element;
}

/** A table whose rows are made anew only where their number changes; a cell is an element or a text. */
export class Table {
  /** `columns` are pairs of a class and a heading; `fill(row, item)` writes an item into the cells of its row. */
  constructor(root, name, columns, fill) {
    this.columns = columns;
    this.fill = fill;
    const table = make("table");
    table.ariaLabel = name;
    const head = make("tr");
    head.append(...columns.map(([kind, heading]) => Object.assign(make("th", kind, heading), { scope: "col" })));
    const [top, body] = [make("thead"), make("tbody")];
    top.append(head);
    table.append(top, body);
    this.body = body;
    root.replaceChildren(table);
  }

  draw(items) {
    const { children } = this.body;
    while (children.length > items.length) this.body.lastChild.remove();
    while (children.length < items.length) {
      const row = make("tr");
      row.append(...this.columns.map(([kind]) => make("td", kind)));
      this.body.append(row);
    }
    items.forEach((item, place) => this.fill(children[place], item));
  }
}

// Text of numbers and times.

const NONE = "–";

export const fixed = (value, digits) => (value === null || value === undefined ? NONE : value.toFixed(digits));
export const percent = (ratio, digits = 0) => (ratio === null || ratio === undefined ? NONE : `${(100 * ratio).toFixed(digits)} %`);
export const count = (value) => value.toLocaleString("en").replaceAll(",", "\u202f");
export const clock = (time_s) => new Date(1000 * time_s).toLocaleTimeString("en-GB");

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

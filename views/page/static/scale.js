// The colour scale: its top, fixed or automatic, and the bar with its labels.

import { roundUp } from "./colour.js";
import { COLOURS } from "./colours.js";

const MN = 1000;
// Number of parts between the labels, by the leading digits of the top: these parts give short labels.
const PARTS = { 1: 5, 1.5: 3, 3: 3, 5: 5, 6: 3 };
const OTHER_PARTS = 4;
// Smallest top of the automatic scale, as a part of the largest force; a smaller top would show noise only.
const LEAST = 0.25;
// The automatic scale shrinks when the images stay below this part of its top for HOLD_MS.
const SHRINK_BELOW = 0.8;
const HOLD_MS = 1500;

export class Scale {
  constructor(root, choice, skin) {
    this.root = root;
    this.skin = skin;
    this.canvas = root.querySelector("canvas");
    this.labels = root.querySelector("ol");
    this.choice = choice;
    this.auto = 0;
    this.lowSince = null;
    this.shown = null;
  }

  /** Stand beside an image of this height, or lie below it. */
  resize(height) {
    this.root.classList.toggle("lies", height === null);
    this.canvas.style.height = this.labels.style.height = height === null ? "" : `${height}px`;
    this.paint(height === null);
  }

  /** The top of the scale in newtons for images whose largest force is `peak`. */
  top(peak) {
    const isAuto = this.choice.querySelector("input:checked").value === "auto";
    const top = isAuto ? this.follow(peak) : this.skin.force_max_n;
    if (top !== this.shown) this.label(top);
    this.shown = top;
    return top;
  }

  follow(peak) {
    const wanted = roundUp(Math.max(peak, LEAST * this.skin.force_max_n));
    const now = performance.now();
    if (wanted > this.auto || this.auto === 0) this.auto = wanted;
    if (wanted === this.auto || peak > SHRINK_BELOW * this.auto) this.lowSince = null;
    else this.lowSince ??= now;
    if (this.lowSince !== null && now - this.lowSince > HOLD_MS) {
      this.auto = wanted;
      this.lowSince = null;
    }
    return this.auto;
  }

  label(top) {
    this.labels.replaceChildren();
    const leading = Number((top * MN / 10 ** Math.floor(Math.log10(top * MN) + 1e-9)).toPrecision(3));
    const parts = PARTS[leading] ?? OTHER_PARTS;
    for (let tick = parts; tick >= 0; tick--) {
      const item = document.createElement("li");
      item.textContent = String(Number(((top * MN * tick) / parts).toPrecision(3)));
      this.labels.append(item);
    }
  }

  paint(lies) {
    const steps = COLOURS.length / 3;
    [this.canvas.width, this.canvas.height] = lies ? [steps, 1] : [1, steps];
    const brush = this.canvas.getContext("2d");
    for (let step = 0; step < steps; step++) {
      brush.fillStyle = `rgb(${COLOURS.slice(3 * step, 3 * step + 3).join(" ")})`;
      brush.fillRect(lies ? step : 0, lies ? 0 : steps - 1 - step, 1, 1);
    }
  }
}

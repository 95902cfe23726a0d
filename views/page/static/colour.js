// The colour of a force, and round tops of scales. The colours are those of views/colours.py.

import { COLOURS } from "./colours.js";

const STEPS = COLOURS.length / 3;

/** Index into COLOURS of `value` on a scale from 0 to `top`. */
export const colourIndex = (value, top) => Math.max(0, Math.min(STEPS - 1, Math.round((value / top) * (STEPS - 1))));

/** The next of 1, 1.5, 2, 3, 4, 5, 6, 8, 10, 15 … that is not below `value`. */
export function roundUp(value) {
  const decade = 10 ** Math.floor(Math.log10(value));
  return [1, 1.5, 2, 3, 4, 5, 6, 8, 10].map((step) => step * decade).find((step) => step >= value * 0.999999);
}

// The image of a skin that is no grid: taxels in their places, as a `View` sees them.

import { colourIndex } from "./colour.js";
import { COLOURS } from "./colours.js";
import { HATCH, Picture } from "./picture.js";
import { BACK, NOTHING } from "./view.js";

// Turns of a drag over the whole canvas, and of a key, radians.
const DRAG = Math.PI;
const KEY = Math.PI / 18;
const KEYS = { ArrowLeft: [-KEY, 0], ArrowRight: [KEY, 0], ArrowUp: [0, -KEY], ArrowDown: [0, KEY] };

const packed = (red, green, blue) => ((255 << 24) | (blue << 16) | (green << 8) | red) >>> 0;
const colourOf = (force, top) => {
  const place = 3 * colourIndex(force, top);
  return packed(COLOURS[place], COLOURS[place + 1], COLOURS[place + 2]);
};
const hex = (text) => packed(...[1, 3, 5].map((place) => parseInt(text.slice(place, place + 2), 16)));
const [GROUND, LINE, WHITE] = [hex(HATCH.ground), hex(HATCH.line), packed(255, 255, 255)];
const SHADE = packed(90, 98, 106);

/** 1 for each of `taxels`, of `count`. */
function flags(taxels, count) {
  const found = new Uint8Array(count);
  for (const each of taxels) found[each] = 1;
  return found;
}

export class SurfacePicture extends Picture {
  /** The pictures of a skin share `view`; `turned()` is called when this picture turns it. */
  constructor(figure, view, pointed, turned) {
    super(figure, pointed);
    this.view = view;
    this.turned = turned;
    if (!view.surface.is_flat) this.letTurn(pointed);
  }

  letTurn(pointed) {
    const { canvas } = this;
    const turn = (...angles) => {
      this.view.turn(...angles);
      this.turned();
    };
    canvas.classList.add("turns");
    canvas.tabIndex = 0;
    canvas.title = "drag, or use the arrow keys, to turn the skin; Home turns it back";
    canvas.onpointerdown = (event) => canvas.setPointerCapture(event.pointerId);
    canvas.onpointermove = (event) => {
      if (!event.buttons) return pointed(this.taxelAt(event));
      const { width, height } = canvas.getBoundingClientRect();
      return turn((DRAG * event.movementX) / width, (DRAG * event.movementY) / height);
    };
    canvas.onkeydown = (event) => {
      if (event.key === "Home") {
        this.view.home();
        this.turned();
      } else if (KEYS[event.key]) turn(...KEYS[event.key]);
      else return;
      event.preventDefault();
    };
  }

  resize(cell) {
    const { view } = this;
    if (view.cell !== cell) view.resize(cell);
    this.resizeTo(view.width, view.height, cell);
    this.pixels = new ImageData(view.width, view.height);
    this.words = new Uint32Array(this.pixels.data.buffer);
  }

  taxelAt(event) {
    const [x, y] = this.placeOf(event);
    const { width, height } = this.view;
    const [column, row] = [Math.floor(x * width), Math.floor(y * height)];
    const taxel = row >= 0 && row < height && column >= 0 && column < width ? this.view.seen()[row * width + column] : NOTHING;
    return taxel < 0 ? null : taxel;
  }

  /** Draw `forces` (newtons) on a scale from 0 to `top`; hatch `hatched` and outline `marked` taxels. */
  draw(forces, top, hatched, marked, taxel) {
    const seen = this.view.seen();
    const { runs, width } = this.view;
    if (runs !== this.runs) {
      this.words.fill(0);
      this.runs = runs;
    }
    const isHatched = flags(hatched, forces.length);
    const isOutlined = flags(taxel === null ? marked : [...marked, taxel], forces.length);
    const period = Math.max(4, Math.round(this.cell));
    for (let run = 0; run < runs.length; run += 3) {
      const [start, end, each] = [runs[run], runs[run + 1], runs[run + 2]];
      this.words.fill(each === BACK ? SHADE : colourOf(forces[each], top), start, end);
      if (isHatched[each]) {
        const place = Math.floor(start / width) + (start % width) - start; // row + column - pixel
        for (let pixel = start; pixel < end; pixel++) this.words[pixel] = (pixel + place) % period < period / 3 ? LINE : GROUND;
      }
      if (isOutlined[each]) {
        for (let pixel = start; pixel < end; pixel++) if (this.isEdge(seen, pixel, each)) this.words[pixel] = WHITE;
      }
    }
    this.canvas.getContext("2d").putImageData(this.pixels, 0, 0);
  }

  isEdge(seen, pixel, taxel) {
    const { width } = this.view;
    return [pixel - 1, pixel + 1, pixel - width, pixel + width].some((beside) => seen[beside] !== taxel);
  }

  /** The pixel of a place; null where its normal faces away. */
  spotOf({ position_m, normal }) {
    return this.view.spotOf(position_m, normal);
  }

  traceAround(brush, { taxels }, x, y) {
    brush.arc(x, y, Math.sqrt(taxels / Math.PI) * this.cell, 0, 2 * Math.PI);
  }
}

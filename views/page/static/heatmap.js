// One tactile image on a canvas: whole device pixels per taxel, hatching over taxels of invalid blocks.

import { colourIndex } from "./colour.js";
import { COLOURS } from "./colours.js";

const HATCH = { ground: "#8a9097", line: "#4d535a" };

export class Heatmap {
  /** `pointed(taxel or null)` is called when the pointer moves over the image. */
  constructor(figure, skin, pointed) {
    this.figure = figure;
    this.skin = skin;
    this.canvas = figure.querySelector("canvas");
    this.veil = figure.querySelector(".veil");
    this.caption = figure.querySelector("figcaption span");
    this.small = new OffscreenCanvas(skin.columns, skin.rows);
    this.pixels = new ImageData(skin.columns, skin.rows);
    this.pixels.data.fill(255);
    this.gaps = skin.block_of_taxel.flatMap((block, taxel) => (block < 0 ? [taxel] : []));
    this.cell = 1;
    this.canvas.onpointermove = (event) => pointed(this.taxelAt(event));
    this.canvas.onpointerleave = () => pointed(null);
  }

  /** Give every taxel `cell` device pixels. */
  resize(cell) {
    const { rows, columns } = this.skin;
    this.cell = cell;
    this.canvas.width = columns * cell;
    this.canvas.height = rows * cell;
    this.canvas.style.width = `${(columns * cell) / devicePixelRatio}px`;
    this.canvas.style.height = `${(rows * cell) / devicePixelRatio}px`;
    this.pattern = null;
  }

  taxelAt(event) {
    const { rows, columns } = this.skin;
    const box = this.canvas.getBoundingClientRect();
    const column = Math.floor(((event.clientX - box.left) / box.width) * columns);
    const row = Math.floor(((event.clientY - box.top) / box.height) * rows);
    return row >= 0 && row < rows && column >= 0 && column < columns ? row * columns + column : null;
  }

  /** Draw `forces` (newtons, row by row) on a scale from 0 to `top`; hatch `hatched` and outline `marked` taxels. */
  draw(forces, top, hatched, marked, taxel) {
    const { data } = this.pixels;
    for (let index = 0; index < forces.length; index++) {
      const colour = 3 * colourIndex(forces[index], top);
      data[4 * index] = COLOURS[colour];
      data[4 * index + 1] = COLOURS[colour + 1];
      data[4 * index + 2] = COLOURS[colour + 2];
    }
    this.small.getContext("2d").putImageData(this.pixels, 0, 0);
    const brush = this.canvas.getContext("2d", { alpha: false });
    brush.imageSmoothingEnabled = false;
    brush.drawImage(this.small, 0, 0, this.canvas.width, this.canvas.height);
    brush.fillStyle = getComputedStyle(document.body).backgroundColor;
    for (const each of this.gaps) this.onCell(each, (x, y) => brush.fillRect(x, y, this.cell, this.cell));
    if (hatched.length) {
      brush.fillStyle = this.hatching(brush);
      for (const each of hatched) this.onCell(each, (x, y) => brush.fillRect(x, y, this.cell, this.cell));
    }
    this.outline(brush, marked, "#ffffffb0", 1);
    if (taxel !== null) this.outline(brush, [taxel], "#ffffff", 2);
  }

  /** Draw a cross and the identity at the centre of force of each contact; those in doubt get a dashed box. */
  markContacts(contacts) {
    const brush = this.canvas.getContext("2d", { alpha: false });
    const arm = Math.max(4 * devicePixelRatio, this.cell);
    brush.font = `600 ${Math.round(12 * devicePixelRatio)}px system-ui, "DejaVu Sans", sans-serif`;
    for (const { identity, row, column, top, bottom, left, right, doubtful_since_mono_ns } of contacts) {
      const [x, y] = [(column + 0.5) * this.cell, (row + 0.5) * this.cell];
      for (const [style, width] of [["#000000c0", 3], ["#ffffff", 1]]) {
        brush.strokeStyle = style;
        brush.lineWidth = width * devicePixelRatio;
        if (doubtful_since_mono_ns) {
          brush.setLineDash([arm, arm]);
          brush.strokeRect(left * this.cell, top * this.cell, (right - left + 1) * this.cell, (bottom - top + 1) * this.cell);
          brush.setLineDash([]);
        }
        brush.beginPath();
        brush.moveTo(x - arm, y);
        brush.lineTo(x + arm, y);
        brush.moveTo(x, y - arm);
        brush.lineTo(x, y + arm);
        brush.stroke();
        brush.lineWidth = 3 * devicePixelRatio;
        if (width > 1) brush.strokeText(String(identity), x + arm, y - arm / 2);
      }
      brush.fillStyle = "#ffffff";
      brush.fillText(String(identity), x + arm, y - arm / 2);
    }
  }

  /** Mark the image as stale with `text`; an empty text removes the mark. */
  setStale(text) {
    this.figure.classList.toggle("stale", Boolean(text));
    this.veil.hidden = !text;
    if (this.veil.textContent !== text) this.veil.textContent = text;
  }

  onCell(taxel, use) {
    use((taxel % this.skin.columns) * this.cell, Math.floor(taxel / this.skin.columns) * this.cell);
  }

  outline(brush, taxels, style, width) {
    brush.strokeStyle = style;
    brush.lineWidth = width;
    for (const each of taxels) {
      this.onCell(each, (x, y) => brush.strokeRect(x + width / 2, y + width / 2, this.cell - width, this.cell - width));
    }
  }

  /** Diagonal lines that continue from one taxel to the next. */
  hatching(brush) {
    if (!this.pattern) {
      const tile = new OffscreenCanvas(this.cell, this.cell);
      const pen = tile.getContext("2d");
      pen.fillStyle = HATCH.ground;
      pen.fillRect(0, 0, this.cell, this.cell);
      pen.strokeStyle = HATCH.line;
      pen.lineWidth = Math.max(1, this.cell / 4);
      for (const shift of [-this.cell, 0, this.cell]) {
        pen.beginPath();
        pen.moveTo(shift, this.cell);
        pen.lineTo(shift + this.cell, 0);
        pen.stroke();
      }
      this.pattern = brush.createPattern(tile, "repeat");
    }
    return this.pattern;
  }
}

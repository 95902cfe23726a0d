// The image of a grid: whole device pixels per taxel, hatching over taxels of invalid blocks.

import { colourIndex } from "./colour.js";
import { COLOURS } from "./colours.js";
import { HATCH, Picture } from "./picture.js";

export class Heatmap extends Picture {
  constructor(figure, skin, pointed) {
    super(figure, pointed);
    this.skin = skin;
    this.canvas.getContext("2d", { alpha: false });
    this.small = new OffscreenCanvas(skin.columns, skin.rows);
    this.pixels = new ImageData(skin.columns, skin.rows);
    this.pixels.data.fill(255);
    this.gaps = skin.block_of_taxel.flatMap((block, taxel) => (block < 0 ? [taxel] : []));
  }

  /** Give every taxel `cell` device pixels. */
  resize(cell) {
    const { rows, columns } = this.skin;
    this.resizeTo(columns * cell, rows * cell, cell);
    this.pattern = null;
  }

  taxelAt(event) {
    const { rows, columns } = this.skin;
    const [x, y] = this.placeOf(event);
    const [row, column] = [Math.floor(y * rows), Math.floor(x * columns)];
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
    const brush = this.canvas.getContext("2d");
    brush.imageSmoothingEnabled = false;
    brush.drawImage(this.small, 0, 0, this.canvas.width, this.canvas.height);
    if (this.gaps.length) brush.fillStyle = getComputedStyle(document.body).backgroundColor;
    for (const each of this.gaps) this.onCell(each, (x, y) => brush.fillRect(x, y, this.cell, this.cell));
    if (hatched.length) {
      brush.fillStyle = this.hatching(brush);
      for (const each of hatched) this.onCell(each, (x, y) => brush.fillRect(x, y, this.cell, this.cell));
    }
    this.outline(brush, marked, "#ffffffb0", 1);
    if (taxel !== null) this.outline(brush, [taxel], "#ffffff", 2);
  }

  spotOf({ row, column }) {
    return [(column + 0.5) * this.cell, (row + 0.5) * this.cell];
  }

  traceAround(brush, { top, bottom, left, right }) {
    brush.rect(left * this.cell, top * this.cell, (right - left + 1) * this.cell, (bottom - top + 1) * this.cell);
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

// How the viewer stands to a skin that is no grid, and which taxel is seen at each pixel. Lengths are in pitches.

// A taxel is drawn up to this distance from its place, and no farther than halfway to the next taxel.
const REACH = 0.8;
// A taxel that is seen from the side is drawn as if its normal had this part towards the viewer.
const LEAST_FACING = 0.05;
// In place of the taxel of a pixel: there is none, or one that faces away.
export const NOTHING = -1;
export const BACK = -2;

const dot = (axis, [x, y, z]) => axis[0] * x + axis[1] * y + axis[2] * z;

export class View {
  /** `surface` is that of the greeting, see views/page/wire.py; a view of another size turns with `main`. */
  constructor(surface, main = null) {
    this.surface = surface;
    this.places = main?.places ?? surface.positions_m.map((place) => this.scaled(place));
    this.pose = main?.pose ?? {};
    if (!main) this.home();
  }

  get axes() {
    return this.pose.axes;
  }

  scaled(position_m) {
    const { middle_m, pitch_m } = this.surface;
    return position_m.map((value, axis) => (value - middle_m[axis]) / pitch_m);
  }

  /** Look at the skin as at first: the axes are unit vectors to the right, down and away. */
  home() {
    this.pose.axes = this.surface.view;
  }

  /** Turn the side that is seen to the right and down, radians. */
  turn(toRight, down) {
    const turned = (axis, away, angle) => [
      axis.map((value, place) => Math.cos(angle) * value - Math.sin(angle) * away[place]),
      axis.map((value, place) => Math.sin(angle) * value + Math.cos(angle) * away[place]),
    ];
    let [x, y, away] = this.axes;
    [x, away] = turned(x, away, toRight);
    [y, away] = turned(y, away, down);
    this.pose.axes = [x, y, away];
  }

  /** Give a pitch `cell` device pixels. */
  resize(cell) {
    this.cell = cell;
    this.width = Math.round(this.surface.width * cell);
    this.height = Math.round(this.surface.height * cell);
    this.taxels = new Int32Array(this.width * this.height);
    this.depths = new Float32Array(this.width * this.height);
    this.drawn = null; // the axes of `taxels`
  }

  /** The pixel of a place on the skin; null where its normal, if it has one, faces away. */
  spotOf(position_m, normal = null) {
    if (normal && dot(this.axes[2], normal) > 0) return null;
    return this.pixelOf(this.scaled(position_m));
  }

  pixelOf(place) {
    return [dot(this.axes[0], place) * this.cell + this.width / 2, dot(this.axes[1], place) * this.cell + this.height / 2];
  }

  /** The taxel at each pixel, row by row, or NOTHING or BACK. */
  seen() {
    if (this.drawn !== this.axes) {
      this.taxels.fill(NOTHING);
      this.depths.fill(Infinity);
      this.places.forEach((place, taxel) => this.put(taxel, place, this.axes.map((axis) => dot(axis, this.surface.normals[taxel]))));
      this.runs = this.runsOf(this.taxels);
      this.drawn = this.axes;
    }
    return this.taxels;
  }

  /** Pixels in a row with the same mark, but for NOTHING: first pixel, pixel behind the last, and mark, in turn. */
  runsOf(taxels) {
    const runs = [];
    for (let pixel = 0, start = 0; pixel < taxels.length; start = pixel) {
      const mark = taxels[pixel];
      const end = (Math.floor(start / this.width) + 1) * this.width;
      while (pixel < end && taxels[pixel] === mark) pixel++;
      if (mark !== NOTHING) runs.push(start, pixel, mark);
    }
    return Int32Array.from(runs);
  }

  /** Put the disc of a taxel where no other is nearer; beside each other the nearest in the plane of the discs wins. */
  put(taxel, place, [slopeX, slopeY, away]) {
    const { cell, width, height, taxels, depths } = this;
    const [x, y] = this.pixelOf(place);
    const depth = dot(this.axes[2], place);
    const facing = Math.sign(away || -1) * Math.max(Math.abs(away), LEAST_FACING);
    const mark = facing < 0 ? taxel : BACK;
    const reach = REACH * cell;
    for (let row = Math.max(0, Math.ceil(y - reach - 0.5)); row < Math.min(height, y + reach); row++) {
      const down = (row + 0.5 - y) / cell;
      for (let column = Math.max(0, Math.ceil(x - reach - 0.5)); column < Math.min(width, x + reach); column++) {
        const right = (column + 0.5 - x) / cell;
        const beyond = -(slopeX * right + slopeY * down) / facing;
        const apart = right * right + down * down + beyond * beyond;
        const pixel = row * width + column;
        if (apart > REACH * REACH || depth + beyond + apart >= depths[pixel]) continue;
        depths[pixel] = depth + beyond + apart;
        taxels[pixel] = mark;
      }
    }
  }
}

// The tactile images, their common scale, and the readout of the taxel under the pointer.

import { touching } from "./contacts.js";
import { Heatmap } from "./heatmap.js";
import { Scale } from "./scale.js";
import { SurfacePicture } from "./surface.js";
import { View } from "./view.js";
import { spaced, span, spoken, write } from "./words.js";

const NAMES = ["image", "true", "sensor"];
// The true and the sensor image are half as large as the reconstructed one.
const HALF = 0.5;
const BAR_PX = 64;
const GAP_PX = 12;
const CAPTION_PX = 31;
// Narrower windows have one column; below `PHONE_PX` the images have all of its width, and the scale lies below.
const WIDE_PX = 1000;
const PHONE_PX = 700;
// What the images leave to what is beside, and above and below: from `BROAD_PX` on, the history is beside them. Part of
// the height of a window of one column.
const BROAD_PX = 1700;
const SIDE_PX = { broad: 560, wide: 400 };
const AROUND_PX = { broad: 206, wide: 473 };
const HIGH_RATIO = 0.75;
const SMALLEST_IMAGE_PX = 320;

/** Bound of the error of the sampling instant, where one is proven. */
const bound = (error_ns) => (error_ns < 0 ? "" : `, sampled ± ${(error_ns / 1000).toFixed(0)} µs`);

export class Images {
  /** `redraw()` is called when the skin was turned. */
  constructor(skin, buses, redraw) {
    this.skin = skin;
    this.view = skin.surface && new View(skin.surface);
    const small = this.view && new View(skin.surface, this.view);
    this.buses = buses;
    this.taxel = null;
    this.block = null;
    this.taxelsOf = Array.from({ length: skin.blocks }, () => []);
    skin.block_of_taxel.forEach((block, taxel) => this.taxelsOf[block]?.push(taxel));
    const pointed = (taxel) => this.point(taxel);
    this.maps = Object.fromEntries(
      NAMES.map((name) => {
        const figure = document.getElementById(`map-${name}`);
        if (!this.view) return [name, new Heatmap(figure, skin, pointed)];
        return [name, new SurfacePicture(figure, name === "image" ? this.view : small, pointed, redraw)];
      }),
    );
    this.scale = new Scale(document.getElementById("scale"), document.getElementById("scaling"), skin);
    this.sized = "";
    const page = document.querySelector("main");
    this.width = page.clientWidth;
    new ResizeObserver(() => (this.width = page.clientWidth)).observe(page);
    this.past = document.querySelector("#map-image .past");
  }

  point(taxel) {
    if (this.skin.block_of_taxel[taxel] < 0) taxel = null; // a gap of the grid
    this.taxel = taxel;
    this.block = taxel === null ? null : this.skin.block_of_taxel[taxel];
    this.buses.mark(this.block);
  }

  pointBlock(block) {
    this.taxel = null;
    this.block = block;
    this.buses.mark(block);
  }

  /**
   * Draw a frame; `hasTruth` tells whether the run has true images. `veil` says why the image is not to be trusted, and
   * `past` of which instant it is; both may be empty.
   */
  draw({ snapshot, pictures }, hasTruth, veil, past) {
    for (const name of ["true", "sensor"]) this.maps[name].figure.hidden = !hasTruth;
    this.fit(hasTruth);
    const forces = Object.values(pictures);
    const peak = forces.reduce((most, each) => each.reduce((high, value) => Math.max(high, value), most), 0);
    const top = this.scale.top(peak);
    const hatched = (snapshot.image?.invalid_blocks ?? []).flatMap((block) => this.taxelsOf[block]).concat(this.skin.masked);
    const marked = this.block === null ? [] : this.taxelsOf[this.block];
    for (const name of NAMES) {
      if (pictures[name]) this.maps[name].draw(pictures[name], top, name === "image" ? hatched : [], marked, this.taxel);
      else this.maps[name].clear();
    }
    if (pictures.image && !veil) {
      const [contacts, centre] = [touching(snapshot), snapshot.patches[0]];
      this.maps.image.markContacts(contacts);
      // The centre of pressure of a skin with one contact is that of the contact.
      if (centre && centre.row !== null && contacts.length > 1) this.maps.image.markCentre(centre);
    }
    this.past.hidden = !past;
    write(this.past, past);
    this.explain(snapshot, veil);
    write(document.getElementById("readout"), this.readout(snapshot, pictures));
  }

  /** Write captions and stale marks. */
  explain({ image, truth, figures }, veil) {
    const old = (age_s) => `stale: ${span(age_s)} old`;
    const { image: rebuilt, true: real, sensor } = this.maps;
    write(rebuilt.caption, image ? `cycle ${image.cycle}${bound(image.sampled_error_ns)}` : "");
    rebuilt.setStale(veil || (image ? (image.stale ? old(image.age_s) : "") : "no image yet"));
    const object = truth?.label ? spoken(truth.label) : "none named";
    write(real.caption, truth ? object : "");
    write(sensor.caption, !truth || figures.sensor_adds_noise === null ? "" : figures.sensor_adds_noise ? "raw" : "in ADC steps");
    for (const map of [real, sensor]) {
      map.setStale(veil || (truth?.stale ? old(truth.age_s) : ""));
      if (!veil && !truth) map.setNone("none of this cycle");
    }
  }

  readout(snapshot, pictures) {
    const { image } = snapshot;
    if (this.block === null) return this.advice();
    const isMasked = this.skin.masked.includes(this.taxel);
    const measured = image && !image.invalid_blocks.includes(this.block) ? (isMasked ? ", masked" : "") : ", not measured";
    const where = `block ${this.block} · ${this.buses.place(this.block)}, ${this.buses.state(this.block)}${measured}`;
    if (this.taxel === null) return `${where} · ${this.taxelsOf[this.block].length} taxels outlined`;
    const mn = (name) => `${(1000 * pictures[name][this.taxel]).toFixed(2)} mN`;
    const forces = NAMES.filter((name) => pictures[name]).map((name) => {
      if (name !== "image") return `${name} ${mn(name)}`;
      return measured ? `guessed ${mn(name)}` : mn(name);
    });
    return `${this.nameOf(this.taxel)}: ${forces.join(" · ")} · ${where}`;
  }

  advice() {
    const turn = this.view && !this.skin.surface.is_flat ? " Drag, or use the arrow keys, to turn the skin." : "";
    return `Point at a taxel for its force, at a node for its taxels.${turn}`;
  }

  nameOf(taxel) {
    if (this.view) return `taxel ${taxel} at ${spaced(this.skin.surface.positions_m[taxel])}`;
    return `row ${Math.floor(taxel / this.skin.columns)}, column ${taxel % this.skin.columns}`;
  }

  /**
   * Choose the largest number of device pixels per taxel that fits the window: a whole number on a grid. The small
   * images are beside the large one or below it, whichever makes the images larger.
   */
  fit(hasTruth) {
    const full = this.width;
    const wanted = `${full} ${innerHeight} ${devicePixelRatio} ${hasTruth}`;
    if (wanted === this.sized) return;
    this.sized = wanted;
    const [rows, columns] = this.view ? [this.skin.surface.height, this.skin.surface.width] : [this.skin.rows, this.skin.columns];
    const [isPhone, isWide] = [innerWidth < PHONE_PX, innerWidth >= WIDE_PX];
    const around = innerWidth >= BROAD_PX ? "broad" : "wide";
    const width = full - (isPhone ? 0 : BAR_PX) - (isWide ? SIDE_PX[around] : 0);
    const height = Math.max(SMALLEST_IMAGE_PX, isWide ? innerHeight - AROUND_PX[around] : innerHeight * HIGH_RATIO);
    const alone = Math.min(width / columns, height / rows);
    const beside = Math.min((width - GAP_PX) / columns / (1 + HALF), height / rows);
    const below = Math.min(width / columns, (height - CAPTION_PX) / rows / (isPhone ? 1 : 1 + HALF));
    const isBelow = hasTruth && (isPhone || below > beside);
    const size = hasTruth ? (isBelow ? below : beside) : alone;
    for (const [name, map] of Object.entries(this.maps)) this.resize(map, name === "image" ? size : size * HALF, columns, isPhone && isBelow, name);
    document.getElementById("pictures").className = hasTruth ? (isBelow ? "below" : "beside") : "alone";
    this.scale.resize(isPhone ? null : this.maps.image.canvas.clientHeight);
  }

  /** On a phone a grid has a few pixels more than its place, and is drawn a little smaller: no stripe stays empty. */
  resize(map, size, columns, isFilled, name) {
    const pixels = size * devicePixelRatio;
    const shown = isFilled && name !== "image" ? (size * columns * 2 - GAP_PX) / 2 : size * columns;
    if (this.view) map.resize(pixels);
    else map.resize(Math.max(1, innerWidth < PHONE_PX ? Math.ceil(pixels) : Math.floor(pixels)));
    if (innerWidth < PHONE_PX) map.showAt(shown);
  }
}

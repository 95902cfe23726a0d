// The tactile images side by side, their common scale, and the readout of the taxel under the pointer.

import { Heatmap } from "./heatmap.js";
import { Scale } from "./scale.js";
import { SurfacePicture } from "./surface.js";
import { View } from "./view.js";
import { span, spoken, write } from "./words.js";

const NAMES = ["image", "true", "sensor"];
const BAR_PX = 64;
const GAP_PX = 12;
// Height of everything above and below the images; smallest size of a taxel, or of the image of a skin that is no grid.
const AROUND_PX = { beside: 400, alone: 240 };
const SMALLEST_PX = 5;
const SMALLEST_IMAGE_PX = 320;
const CAPTION_PX = 30;
// Contacts described in words below the images; all are marked.
const MOST_DESCRIBED = 3;

/** The contacts that are known now. */
const touching = ({ contacts }) => (contacts && !contacts.stale && !contacts.blind ? contacts.contacts : []);

/** Bound of the error of the sampling instant, where one is proven. */
const bound = (error_ns) => (error_ns < 0 ? "" : `, sampled within ${(error_ns / 1000).toFixed(0)} µs`);

/** Text of a place in the frame of the skin. */
const spaced = (position_m) => `x ${position_m.map((value) => (1000 * value).toFixed(1)).join(", ")} mm`.replace(/, (.*), /, ", y $1, z ");

/** Text of the strongest contacts. */
function described(contacts, isGrid) {
  const each = contacts.slice(0, MOST_DESCRIBED).map(({ identity, force_n, row, column, position_m, taxels, invalid_taxels, doubtful_since_mono_ns }) => {
    const where = isGrid ? `row ${row.toFixed(1)}, column ${column.toFixed(1)}` : spaced(position_m);
    const guessed = (invalid_taxels ? `, ${invalid_taxels} not measured` : "") + (doubtful_since_mono_ns ? ", in doubt" : "");
    return `${identity}: ${(1000 * force_n).toFixed(0)} mN at ${where}, ${taxels} taxels${guessed}`;
  });
  const more = contacts.length > MOST_DESCRIBED ? [`${contacts.length - MOST_DESCRIBED} more`] : [];
  return each.length ? `contact ${[...each, ...more].join(" · ")}` : "";
}

export class Images {
  /** `redraw()` is called when the skin was turned. */
  constructor(skin, buses, redraw) {
    this.skin = skin;
    this.view = skin.surface && new View(skin.surface);
    this.buses = buses;
    this.taxel = null;
    this.block = null;
    this.taxelsOf = Array.from({ length: skin.blocks }, () => []);
    skin.block_of_taxel.forEach((block, taxel) => this.taxelsOf[block]?.push(taxel));
    const pointed = (taxel) => this.point(taxel);
    this.maps = Object.fromEntries(
      NAMES.map((name) => {
        const figure = document.getElementById(`map-${name}`);
        return [name, this.view ? new SurfacePicture(figure, this.view, pointed, redraw) : new Heatmap(figure, skin, pointed)];
      }),
    );
    this.scale = new Scale(document.getElementById("scale"), document.getElementById("scaling"), skin);
    this.sized = "";
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

  /** Draw a frame; `lost` is the text to show when frames have stopped, else empty. */
  draw({ snapshot, pictures }, lost) {
    this.show(snapshot);
    this.fit(Boolean(snapshot.truth));
    const forces = Object.values(pictures);
    const peak = forces.reduce((most, each) => each.reduce((high, value) => Math.max(high, value), most), 0);
    const top = this.scale.top(peak);
    const hatched = (snapshot.image?.invalid_blocks ?? []).flatMap((block) => this.taxelsOf[block]);
    const marked = this.block === null ? [] : this.taxelsOf[this.block];
    for (const name of NAMES) {
      if (pictures[name]) this.maps[name].draw(pictures[name], top, name === "image" ? hatched : [], marked, this.taxel);
    }
    if (pictures.image && !lost) this.maps.image.markContacts(touching(snapshot));
    this.explain(snapshot, lost);
    write(document.getElementById("readout"), this.readout(snapshot, pictures));
  }

  show({ truth }) {
    document.body.classList.toggle("alone", !truth);
    for (const name of ["true", "sensor"]) this.maps[name].figure.hidden = !truth;
  }

  /** Write captions and stale marks. */
  explain({ image, truth, figures }, lost) {
    const old = (age_s) => `stale: ${span(age_s)} old`;
    const { image: rebuilt, true: real, sensor } = this.maps;
    write(rebuilt.caption, image ? `cycle ${image.cycle}${bound(image.sampled_error_ns)}` : "");
    rebuilt.setStale(lost || (image ? (image.stale ? old(image.age_s) : "") : "no image yet"));
    if (!truth) return;
    const object = truth.label ? spoken(truth.label) : "no object named";
    write(real.caption, `${truth.of_image ? "same cycle" : `step ${truth.step}`}, ${object}`);
    write(sensor.caption, figures.sensor_adds_noise ? "true with noise, in ADC steps" : "true in ADC steps");
    for (const map of [real, sensor]) map.setStale(lost || (truth.stale ? old(truth.age_s) : ""));
  }

  readout(snapshot, pictures) {
    const { image } = snapshot;
    if (this.block === null) return described(touching(snapshot), !this.view) || this.advice();
    const measured = image && !image.invalid_blocks.includes(this.block) ? "" : ", not measured";
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

  /** Choose the largest number of device pixels per taxel that fits the window: a whole number on a grid. */
  fit(beside) {
    const width = document.getElementById("images").clientWidth;
    const wanted = `${width} ${innerHeight} ${innerWidth} ${devicePixelRatio} ${beside}`;
    if (wanted === this.sized) return;
    this.sized = wanted;
    const [rows, columns] = this.view ? [this.skin.surface.height, this.skin.surface.width] : [this.skin.rows, this.skin.columns];
    const smallest = this.view ? SMALLEST_IMAGE_PX / rows : SMALLEST_PX;
    const images = beside ? NAMES.length : 1;
    const wide = (perRow) => ((beside || innerWidth < 960 ? width : innerWidth * 0.5) - BAR_PX - (perRow - 1) * GAP_PX) / perRow / columns;
    const high = (perRow) => {
      const lines = Math.ceil(images / perRow);
      return Math.max(smallest, ((innerHeight - AROUND_PX[beside ? "beside" : "alone"]) / lines - (lines > 1 ? CAPTION_PX : 0)) / rows);
    };
    // A narrow window scrolls. In a wide window choose the number of images per row that makes them largest.
    let perRow = Math.min(images, innerWidth < 560 ? 1 : 2);
    let size = wide(perRow);
    if (innerWidth >= 960) {
      size = 0;
      for (let each = images; each >= 1; each--) {
        const fits = Math.min(wide(each), high(each));
        if (fits > size + 0.01) [perRow, size] = [each, fits];
      }
    }
    const cell = this.view ? size * devicePixelRatio : Math.max(1, Math.floor(size * devicePixelRatio));
    for (const map of Object.values(this.maps)) map.resize(cell);
    this.scale.resize((rows * cell) / devicePixelRatio);
    document.getElementById("pictures").style.setProperty("--per-row", perRow);
  }
}

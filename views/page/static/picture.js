// One tactile image on a canvas: what heat maps of grids and pictures of other skins have in common.

import { write } from "./words.js";

export const HATCH = { ground: "#8a9097", line: "#4d535a" };

export class Picture {
  /** `pointed(taxel or null)` is called when the pointer moves over the image. */
  constructor(figure, pointed) {
    this.figure = figure;
    this.canvas = figure.querySelector("canvas");
    this.veil = figure.querySelector(".veil");
    this.caption = figure.querySelector("figcaption span");
    this.cell = 1;
    this.canvas.onpointermove = (event) => pointed(this.taxelAt(event));
    this.canvas.onpointerleave = () => pointed(null);
  }

  /** Make the canvas `width` by `height` device pixels; `cell` of them are the distance of two taxels. */
  resizeTo(width, height, cell) {
    this.cell = cell;
    this.canvas.width = width;
    this.canvas.height = height;
    this.canvas.style.width = `${width / devicePixelRatio}px`;
    this.canvas.style.height = `${height / devicePixelRatio}px`;
  }

  /** Show the canvas so many CSS pixels wide, whatever pixels it has. */
  showAt(width) {
    this.canvas.style.width = `${width}px`;
    this.canvas.style.height = `${(width * this.canvas.height) / this.canvas.width}px`;
  }

  /** Draw no image. */
  clear() {
    this.canvas.getContext("2d").clearRect(0, 0, this.canvas.width, this.canvas.height);
  }

  /** The pointer's place, 0 to 1 to the right and down. */
  placeOf(event) {
    const box = this.canvas.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
  }

  /** Half the size of a mark: that of a taxel, within limits. */
  arm() {
    return Math.max(5, Math.min(12, this.cell / devicePixelRatio)) * devicePixelRatio;
  }

  /** Draw a cross and the identity at the centre of force of each contact; those in doubt get a dashed line around. */
  markContacts(contacts) {
    const brush = this.canvas.getContext("2d");
    const arm = this.arm();
    brush.font = `600 ${Math.round(12 * devicePixelRatio)}px system-ui, "DejaVu Sans", sans-serif`;
    for (const contact of contacts) {
      const spot = this.spotOf(contact);
      if (!spot) continue; // on the side that is not seen
      const [x, y] = spot;
      const name = String(contact.identity);
      for (const [style, width] of [["#000000c0", 3], ["#ffffff", 1]]) {
        brush.strokeStyle = style;
        brush.lineWidth = width * devicePixelRatio;
        if (contact.doubtful_since_mono_ns) {
          brush.setLineDash([arm, arm]);
          brush.beginPath();
          this.traceAround(brush, contact, x, y);
          brush.stroke();
          brush.setLineDash([]);
        }
        brush.beginPath();
        brush.moveTo(x - arm, y);
        brush.lineTo(x + arm, y);
        brush.moveTo(x, y - arm);
        brush.lineTo(x, y + arm);
        brush.stroke();
        brush.lineWidth = 3 * devicePixelRatio;
        if (width > 1) brush.strokeText(name, x + arm, y - arm / 2);
      }
      brush.fillStyle = "#ffffff";
      brush.fillText(name, x + arm, y - arm / 2);
    }
  }

  /** Draw a diamond at the centre of pressure. */
  markCentre(place) {
    const spot = this.spotOf(place);
    if (!spot) return;
    const [x, y] = spot;
    const brush = this.canvas.getContext("2d");
    const arm = this.arm();
    for (const [style, width] of [["#000000c0", 4], ["#ffd479", 1.5]]) {
      brush.strokeStyle = style;
      brush.lineWidth = width * devicePixelRatio;
      brush.beginPath();
      for (const [right, down] of [[0, -arm], [arm, 0], [0, arm], [-arm, 0]]) brush.lineTo(x + right, y + down);
      brush.closePath();
      brush.stroke();
    }
  }

  /** Mark the image as stale with `text`; an empty text removes the mark. */
  setStale(text) {
    this.figure.classList.toggle("stale", Boolean(text));
    this.say(text, "veil");
  }

  /** Say why there is no image. */
  setNone(text) {
    this.say(text, "veil calm");
  }

  say(text, kind) {
    this.veil.className = kind;
    this.veil.hidden = !text;
    write(this.veil, text);
  }
}

// The contacts as a table, each with its curve, and the regions with their thresholds.

import { roundUp } from "./colour.js";
import { curve, inks, prepared } from "./curves.js";
import { Table, count, force, make, millinewtons, span, write } from "./words.js";

// Time that a curve shows.
const CURVE_S = 10;
// A curve of noise alone shall not fill its place.
const LEAST_N = 0.02;

const MM = ([x, y, z]) => [x, y, z].map((value) => (1000 * value).toFixed(1)).join(", ");

/** The contacts that are known now. */
export const touching = ({ contacts }) => (contacts && !contacts.stale && !contacts.blind ? contacts.contacts : []);

/** A place by its numbers, as the headings say. */
const numbers = ({ row, column, position_m }, isGrid) => (isGrid ? `${row.toFixed(1)}, ${column.toFixed(1)}` : MM(position_m));

export class Contacts {
  constructor(skin, history) {
    this.history = history;
    this.isGrid = !skin.surface;
    this.root = document.getElementById("contacts");
    this.heading = this.root.querySelector("h2");
    const place = this.isGrid ? "Row, column" : "x, y, z mm";
    const columns = [["name", "No."], ["force", "Force"], ["peak", "Peak"], ["taxels", "Taxels"], ["age", "Age"], ["place", place], ["curve", `Last ${CURVE_S} s`]];
    this.table = new Table(this.root.querySelector(".rows"), "Contacts", columns, (row, contact) => this.fill(row, contact));
    this.root.querySelector("table").classList.toggle("spatial", !this.isGrid);
    this.list = [];
    this.hasBeen = false;
  }

  /** Draw the contacts of a snapshot. */
  draw(snapshot) {
    const { contacts, playback } = snapshot;
    this.hasBeen ||= Boolean(contacts);
    this.root.hidden = !this.hasBeen && Boolean(playback);
    const list = touching(snapshot);
    const state = !contacts ? "none known yet" : contacts.blind ? "the skin is not measured" : contacts.stale ? `${span(contacts.age_s)} old` : String(list.length || "none");
    this.root.classList.toggle("stale", Boolean(contacts?.stale || contacts?.blind));
    write(this.heading, `Contacts, mN · ${state}`);
    const had = this.list.map(({ identity }) => identity).join();
    this.list = list;
    this.sampled_mono_ns = contacts?.sampled_mono_ns;
    this.time_s = snapshot.time_s;
    this.table.draw(list);
    if (had !== list.map(({ identity }) => identity).join()) this.drawCurves();
  }

  fill(row, contact) {
    const [name, total, peak, taxels, age, place, curved] = row.children;
    const isDoubtful = Boolean(contact.doubtful_since_mono_ns);
    row.className = isDoubtful ? "doubtful" : "";
    write(name, String(contact.identity));
    write(total, millinewtons(contact.force_n));
    write(peak, millinewtons(contact.peak_n));
    write(taxels, count(contact.taxels));
    const since = (mono_ns) => span((this.sampled_mono_ns - mono_ns) * 1e-9);
    write(age, since(contact.onset_mono_ns));
    write(place, numbers(contact, this.isGrid));
    if (!curved.firstChild) {
      const canvas = make("canvas");
      canvas.ariaHidden = "true";
      curved.append(canvas, make("span"));
    }
    const doubt = isDoubtful ? `in doubt for ${since(contact.doubtful_since_mono_ns)}` : "";
    const guess = contact.invalid_taxels ? `${contact.invalid_taxels} taxels not measured` : "";
    write(curved.lastChild, [doubt, guess].filter(Boolean).join(" · "));
  }

  /** Draw the curves: all on one scale, so that they can be compared. */
  drawCurves() {
    const { list, table, time_s } = this;
    if (!list.length) return;
    const ink = inks();
    const moments = this.history.between(time_s - CURVE_S, time_s);
    const forces = list.map(({ identity, force_n }) => [
      ...moments.map((moment) => [moment.time_s, moment.contacts?.find(([name]) => name === identity)?.[1] ?? null]),
      [time_s, force_n],
    ]);
    const top = roundUp(forces.flat().reduce((high, [, value]) => Math.max(high, value ?? 0), LEAST_N));
    list.forEach((contact, place) => {
      const canvas = table.body.children[place].lastChild.firstChild;
      const [brush, width, height] = prepared(canvas, canvas.clientHeight);
      const isDoubtful = Boolean(contact.doubtful_since_mono_ns);
      const x = (at_s) => width * (1 + (at_s - time_s) / CURVE_S);
      const y = (value) => height - 1 - (value / top) * (height - 3);
      brush.fillStyle = ink.line;
      brush.fillRect(0, height - 1, width, 1);
      const [stroke, fill] = isDoubtful ? [ink.warning, null] : [ink.accent, ink["accent-soft"]];
      curve(brush, forces[place], { x, y, stroke, fill, base: height - 1, isDashed: isDoubtful });
    });
  }
}

export class Regions {
  constructor(skin) {
    this.isGrid = !skin.surface;
    this.root = document.getElementById("regions");
    const columns = [["name", "Region"], ["force", "Force"], ["bar", ""], ["threshold", "Threshold"], ["place", this.isGrid ? "Centre: row, column" : "Centre: x, y, z mm"]];
    this.table = new Table(this.root.querySelector(".rows"), "Regions", columns, (row, patch) => this.fill(row, patch));
  }

  /** Draw the regions of a snapshot but for the whole skin, whose force is among the figures. */
  draw(snapshot) {
    const { patches, image } = snapshot;
    this.root.hidden = patches.length < 2;
    if (this.root.hidden) return;
    this.root.classList.toggle("stale", !image || image.stale);
    this.root.classList.toggle("unbounded", patches.slice(1).every(({ threshold_n }) => threshold_n === null));
    this.most = Math.max(LEAST_N, ...patches.slice(1).map(({ force_n }) => force_n ?? 0));
    this.hasCentre = hasCentre(snapshot);
    this.table.draw(patches.slice(1));
  }

  fill(row, patch) {
    const [name, total, bar, threshold, place] = row.children;
    row.className = [patch.is_over && "over", patch.is_doubtful && "doubtful"].filter(Boolean).join(" ");
    write(name, patch.name);
    write(total, patch.force_n === null ? "not measured" : force(patch.force_n) + (patch.is_doubtful ? ", in doubt" : ""));
    write(threshold, patch.threshold_n === null ? "" : `${patch.is_over ? "over" : "up to"} ${force(patch.threshold_n)}`);
    write(place, this.hasCentre && patch.row !== null && patch.force_n > LEAST_N / 10 ? numbers(patch, this.isGrid) : "");
    if (!bar.firstChild) {
      const meter = make("div", "meter");
      meter.append(make("div"));
      bar.append(meter);
    }
    const part = (patch.force_n ?? 0) / (patch.threshold_n ?? this.most);
    bar.firstChild.firstChild.style.width = `${100 * Math.max(0, Math.min(1, part))}%`;
  }
}

/** Whether the centre of pressure is that of a touch: of a skin that nothing touches it is a centre of noise. */
export const hasCentre = (snapshot) => !snapshot.contacts || touching(snapshot).length > 0;

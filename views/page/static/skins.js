// All skins of a hub side by side, on one colour scale; each leads to the page of its own.

import { Heatmap } from "./heatmap.js";
import { touching } from "./contacts.js";
import { Scale } from "./scale.js";
import { Connection } from "./socket.js";
import { SurfacePicture } from "./surface.js";
import { View } from "./view.js";
import { force, spoken, write } from "./words.js";

const SEARCH_MS = 2000;
const LOST_MS = 1000;
// The largest map of a skin, CSS pixels.
const MAP_PX = 420;
const SCALE_PX = 240;

const all = document.getElementById("skins");
const tiles = new Map();
const scale = new Scale(document.getElementById("scale"), document.getElementById("scaling"), { force_max_n: 0 });
let isDue = false;

/** A skin: its map, what touches, and what is most wrong. */
class Tile {
  constructor(name) {
    this.figure = document.querySelector("template").content.firstElementChild.cloneNode(true);
    this.figure.dataset.skin = name;
    const link = this.figure.querySelector("a");
    link.href = `/skins/${name}/`;
    link.textContent = name;
    this.figure.querySelector("canvas").ariaLabel = `Reconstructed forces of ${name}`;
    all.append(this.figure);
    this.connection = new Connection((skin) => this.setSkin(skin), (frame) => this.take(frame), `/skins/${name}/`);
  }

  setSkin(skin) {
    this.skin = skin;
    this.frame = null;
    this.taxelsOf = Array.from({ length: skin.blocks }, () => []);
    skin.block_of_taxel.forEach((block, taxel) => this.taxelsOf[block]?.push(taxel));
    const pointed = () => {};
    this.map = skin.surface ? new SurfacePicture(this.figure, new View(skin.surface), pointed, schedule) : new Heatmap(this.figure, skin, pointed);
    const { height, width } = skin.surface ?? { height: skin.rows, width: skin.columns };
    const pixels = (MAP_PX * devicePixelRatio) / Math.max(width, height);
    this.map.resize(skin.surface ? pixels : Math.max(1, Math.floor(pixels)));
  }

  take(frame) {
    this.frame = frame;
    schedule();
  }

  get peak() {
    return (this.frame?.pictures.image ?? []).reduce((most, force_n) => Math.max(most, force_n), 0);
  }

  draw(top) {
    if (!this.frame) return;
    const { snapshot, pictures } = this.frame;
    const { image, label, notices, patches } = snapshot;
    const hatched = (image?.invalid_blocks ?? []).flatMap((block) => this.taxelsOf[block]).concat(this.skin.masked);
    if (pictures.image) {
      this.map.draw(pictures.image, top, hatched, [], null);
      this.map.markContacts(touching(snapshot));
    } else this.map.clear();
    const isLost = this.connection.silence() > LOST_MS;
    this.map.setStale(isLost ? "stale: connection lost" : !image ? "no image yet" : image.stale ? "stale" : "");
    const said = label?.measured && !label.stale ? spoken(label.label || "no contact") : "";
    const total = patches[0]?.force_n ?? null;
    write(this.map.caption, [total === null ? "" : force(total), said].filter(Boolean).join(" · "));
    const worst = notices.find(({ level }) => level === "error") ?? notices.find(({ level }) => level === "warning");
    const line = this.figure.querySelector(".detail");
    line.className = `detail ${worst?.level ?? ""}`;
    write(line, worst?.text ?? "");
  }
}

function schedule() {
  if (isDue) return;
  isDue = true;
  requestAnimationFrame(() => {
    isDue = false;
    const shown = [...tiles.values()];
    scale.skin.force_max_n = Math.max(0, ...shown.map(({ skin }) => skin?.force_max_n ?? 0));
    if (!scale.skin.force_max_n) return;
    const top = scale.top(Math.max(...shown.map(({ peak }) => peak)));
    for (const tile of shown) tile.draw(top);
  });
}

/** Show the skins that have come. */
async function search() {
  try {
    for (const name of await (await fetch("/api/skins")).json()) if (!tiles.has(name)) tiles.set(name, new Tile(name));
    write(document.getElementById("skin"), `${tiles.size} skins`);
  } catch {
    // the connections of the skins say that the viewer is away
  }
}

if (location.search) window.history.replaceState(null, "", location.pathname);
scale.resize(SCALE_PX);
search();
setInterval(search, SEARCH_MS);
setInterval(schedule, 250);
addEventListener("schemechange", schedule);
document.getElementById("scaling").addEventListener("change", schedule);

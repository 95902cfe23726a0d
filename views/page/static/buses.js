// A card for each bus with its load and one tile per node, and the frame counters.

import { count, make, percent, span, write } from "./words.js";

// Counter, its name on the page, and whether a value above 0 is bad. Most other frames are heartbeats.
const COUNTERS = [
  ["accepted", "in time", false],
  ["missing", "missing", true],
  ["late", "late", true],
  ["duplicate", "duplicate", true],
  ["malformed", "malformed", true],
  ["foreign", "other frames", false],
];

const rate = (bits) => (bits < 1e6 ? `${bits / 1e3} kbit/s` : `${bits / 1e6} Mbit/s`);
const bitrates = ({ bitrate, data_bitrate: data }) => (data ? `FD, ${rate(bitrate)} and ${rate(data)}` : rate(bitrate));

function counter(name) {
  const row = make("div");
  row.append(make("dt", "", name), make("dd"));
  return row;
}

export class Buses {
  /** `pointed(block or null)` is called when the pointer enters or leaves a node. */
  constructor(skin, pointed) {
    this.tiles = []; // by block
    this.nmt = skin.nmt; // names of the NMT states
    this.cards = new Map();
    const root = document.getElementById("buses");
    root.replaceChildren(...skin.buses.map((bus) => this.card(bus, pointed)));
    this.counters = document.querySelector("#frames dl");
  }

  card(bus, pointed) {
    const card = make("div", "card bus");
    const head = make("h2", "", bus.name);
    const load = make("span", "load", "–");
    head.append(make("small", "", bitrates(bus)), load);
    const meter = make("div", "meter");
    const [fill, mean] = [make("div"), make("i")];
    mean.title = "mean load since SYNC started";
    meter.append(fill, mean);
    const nodes = make("div", "nodes");
    for (let node = 1; node <= bus.nodes; node++) {
      const tile = make("i", "tile unknown", String(node));
      const block = bus.first_block + (node - 1) * bus.blocks_per_node;
      tile.onpointerenter = () => pointed(block);
      tile.onpointerleave = () => pointed(null);
      for (let each = 0; each < bus.blocks_per_node; each++) this.tiles[block + each] = tile;
      nodes.append(tile);
    }
    const detail = make("p", "detail", "no status yet");
    card.append(head, meter, nodes, detail);
    this.cards.set(bus.name, { bus, card, load, fill, mean, detail });
    return card;
  }

  /** Draw the gateway's status, or a text if there is none. */
  draw(gateway) {
    for (const each of this.cards.values()) {
      const seen = gateway?.buses.find(({ name }) => name === each.bus.name);
      each.card.classList.toggle("stale", !seen || gateway.stale);
      each.card.classList.toggle("dead", Boolean(seen?.dead));
      if (seen) this.drawBus(each, seen, gateway);
      else write(each.detail, gateway ? "the gateway does not serve this bus" : "no status yet");
    }
    document.getElementById("frames").classList.toggle("stale", !gateway || gateway.stale);
    if (gateway) this.drawCounters(gateway);
  }

  drawBus({ bus, load, fill, mean, detail }, seen, gateway) {
    const isKnown = !seen.dead && !gateway.stale;
    const ratio = isKnown ? seen.load_ratio : 0;
    write(load, isKnown ? percent(ratio, 1) : "–");
    fill.style.width = `${100 * Math.min(1, ratio)}%`;
    fill.className = ratio > 0.95 ? "full" : "";
    mean.style.left = `${100 * Math.min(1, seen.mean_load_ratio)}%`;
    let operational = 0;
    seen.nodes.forEach((node, place) => {
      const tile = node >= 1 && node <= bus.nodes ? this.tiles[bus.first_block + (node - 1) * bus.blocks_per_node] : null;
      const heard = this.nmt[seen.nmt[place]] ?? "unknown";
      const isRefused = seen.refused.includes(node) && heard !== "silent";
      const state = seen.dead ? "unknown" : isRefused ? "refused" : heard;
      operational += state === "operational";
      if (!tile || tile.dataset.state === state) return;
      tile.dataset.state = state;
      tile.className = `tile ${state}`;
      tile.title = `${bus.name}, node ${node}: ${state}`;
    });
    const nodes = seen.dead ? "dead: no node can be heard" : `${operational} of ${seen.nodes.length} nodes operational`;
    write(detail, gateway.stale ? `${nodes} ${span(gateway.age_s)} ago` : nodes);
  }

  drawCounters(gateway) {
    const rows = [["cycles complete", gateway.cycles ? percent(gateway.cycles_complete / gateway.cycles, 2) : "–", false]];
    for (const [key, name, isBad] of COUNTERS) {
      const value = gateway.frames[key];
      rows.push([name, count(value), isBad && value > 0]);
    }
    if (gateway.zero) rows.push(["zero of the blocks", gateway.zero, false]);
    if (this.counters.childElementCount !== rows.length) this.counters.replaceChildren(...rows.map(([name]) => counter(name)));
    rows.forEach(([, value, isBad], place) => {
      const cell = this.counters.children[place].lastChild;
      write(cell, value);
      cell.classList.toggle("bad", isBad);
    });
  }

  /** Mark the tile of `block`, or none. */
  mark(block) {
    this.marked?.classList.remove("marked");
    this.marked = block === null ? null : this.tiles[block];
    this.marked?.classList.add("marked");
  }

  /** Name the bus and node of `block`. */
  place(block) {
    for (const { bus } of this.cards.values()) {
      const node = Math.floor((block - bus.first_block) / bus.blocks_per_node) + 1;
      if (node >= 1 && node <= bus.nodes) return `${bus.name} node ${node}`;
    }
    return "";
  }

  state(block) {
    return this.tiles[block].dataset.state ?? "unknown";
  }
}

// A card for each bus with its load and one tile per node, and the frame counters.

import { clock, count, make, percent, span, write } from "./words.js";

// Counter and its name on the page. Most other frames are heartbeats.
const COUNTERS = [
  ["accepted", "in time"],
  ["missing", "missing"],
  ["late", "late"],
  ["duplicate", "duplicate"],
  ["malformed", "malformed"],
  ["foreign", "other frames"],
];

// Newest emergencies that are told of a node.
const EMERGENCIES = 2;
const CARD_PX = 250;

/** Cards beside each other: as many as leave the least empty places in the last line. */
function across(cards, width) {
  const most = Math.max(1, Math.min(cards, Math.floor(width / CARD_PX)));
  const empty = (each) => (each - (cards % each)) % each;
  return Array.from({ length: most }, (_, place) => most - place).reduce((best, each) => (empty(each) < empty(best) ? each : best));
}

// Nodes farther on by a key.
const KEYS = { ArrowLeft: -1, ArrowRight: 1, Home: -Infinity, End: Infinity };

/** Let the arrow keys go from node to node. */
function walk(event, nodes) {
  const tiles = [...nodes.children];
  const across = tiles.findIndex(({ offsetTop }) => offsetTop > tiles[0].offsetTop);
  const step = { ...KEYS, ArrowUp: -across, ArrowDown: across }[event.key];
  if (!step) return;
  event.preventDefault();
  const place = Math.max(0, Math.min(tiles.length - 1, tiles.indexOf(event.target) + step));
  for (const tile of tiles) tile.tabIndex = tile === tiles[place] ? 0 : -1;
  tiles[place].focus();
}

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
    [this.since, this.counters] = document.querySelectorAll("#frames h2, #frames dl");
    new ResizeObserver(() => root.style.setProperty("--across", across(skin.buses.length, root.clientWidth))).observe(root);
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
    nodes.role = "group";
    nodes.ariaLabel = `Nodes of ${bus.name}`;
    const detail = make("p", "detail", "no status yet");
    const parts = { bus, card, load, fill, mean, detail, nodes, pointed: null };
    for (let place = 0; place < bus.nodes; place++) {
      const tile = make("button", "tile unknown", String(place + 1));
      const block = bus.first_block + place * bus.blocks_per_node;
      tile.type = "button";
      tile.tabIndex = place ? -1 : 0; // one stop for the Tab key; arrows go on
      const point = (isPointed) => {
        parts.pointed = isPointed ? tile : null;
        this.write(parts);
        pointed(isPointed ? block : null);
      };
      tile.onpointerenter = tile.onfocus = () => point(true);
      tile.onpointerleave = tile.onblur = () => point(false);
      for (let each = 0; each < bus.blocks_per_node; each++) this.tiles[block + each] = tile;
      nodes.append(tile);
    }
    nodes.onkeydown = (event) => walk(event, nodes);
    card.append(head, meter, nodes, detail);
    this.cards.set(bus.name, parts);
    return card;
  }

  /** Write what the pointer or the keyboard is at, or the sum of the bus. */
  write({ detail, pointed, summary }) {
    write(detail, pointed ? (pointed.dataset.about ?? "no status yet") : (summary ?? "no status yet"));
  }

  /** Draw the gateway's status, or a text if there is none; a recording without one has no such cards. */
  draw({ gateway, playback, time_s }) {
    document.getElementById("wires").hidden = Boolean(playback && !gateway);
    this.time_s = time_s;
    for (const each of this.cards.values()) {
      const seen = gateway?.buses.find(({ name }) => name === each.bus.name);
      each.card.classList.toggle("stale", !seen || gateway.stale);
      each.card.classList.toggle("dead", Boolean(seen?.dead));
      if (seen) this.drawBus(each, seen, gateway);
      else each.summary = gateway ? "the gateway does not serve this bus" : "no status yet";
      this.write(each);
    }
    document.getElementById("frames").classList.toggle("stale", !gateway || gateway.stale);
    if (gateway) this.drawCounters(gateway);
  }

  drawBus(parts, seen, gateway) {
    const { bus, load, fill, mean } = parts;
    const isKnown = !seen.dead && !gateway.stale;
    const ratio = isKnown ? seen.load_ratio : 0;
    write(load, isKnown ? percent(ratio, 1) : "–");
    fill.style.width = `${100 * Math.min(1, ratio)}%`;
    fill.className = ratio > 0.95 ? "full" : "";
    mean.style.left = `${100 * Math.min(1, seen.mean_load_ratio)}%`;
    const troubles = new Map(seen.nodes_why.map((trouble) => [trouble.node, trouble]));
    let operational = 0;
    seen.nodes.forEach((node, place) => {
      const tile = place < bus.nodes ? this.tiles[bus.first_block + place * bus.blocks_per_node] : null;
      const heard = this.nmt[seen.nmt[place]] ?? "unknown";
      const isRefused = seen.refused.includes(node) && heard !== "silent";
      const state = seen.dead ? "unknown" : isRefused ? "refused" : heard;
      operational += state === "operational";
      const lost = [[seen.missing[place], "missing"], [seen.late[place], "late"]].filter(([frames]) => frames > 0);
      const emergencies = seen.emergencies.filter((each) => each.node === node).slice(-EMERGENCIES);
      const told = emergencies.map(({ code, time_ns }) => `${code.toString(16).toUpperCase().padStart(4, "0")}h at ${clock(1e-9 * time_ns)}`);
      const counted = [...lost.map(([frames, how]) => ` · ${count(frames)} frames ${how}`), ...told.map((each) => ` · EMCY ${each}`)].join("");
      if (tile) this.drawNode(tile, { bus, node, state, counted, trouble: troubles.get(node) });
    });
    const nodes = seen.dead ? "dead: no node can be heard" : `${operational} of ${seen.nodes.length} nodes operational`;
    parts.summary = gateway.stale ? `${nodes} ${span(gateway.age_s)} ago` : nodes;
  }

  drawNode(tile, { bus, node, state, counted, trouble }) {
    const why = trouble && trouble.why !== state ? `: ${trouble.why}` : "";
    const since = trouble ? ` since ${clock(trouble.since_time_s)}` : "";
    const about = `node ${node} ${state}${why}${since}`;
    tile.dataset.about = `${about}${trouble ? `, ${span(Math.max(0, this.time_s - trouble.since_time_s))}` : ""}${counted}`;
    if (tile.dataset.written === about) return;
    tile.dataset.written = about;
    tile.dataset.state = state;
    tile.className = `tile ${state}${trouble && state === "operational" ? " losing" : ""}${tile === this.marked ? " marked" : ""}`;
    tile.title = `${bus.name}, node ${node}: ${state}${why}${since}`;
    tile.ariaLabel = tile.title;
    write(tile, String(node));
  }

  drawCounters(gateway) {
    const { cycles, cycles_complete: complete, sync_rate_hz: rate_hz, frames, zero } = gateway;
    write(this.since, `Frames of the ${rate_hz ? `${span(cycles / rate_hz)} ` : ""}since the gateway started SYNC`);
    const rows = [["cycles complete", cycles ? percent(complete / cycles, 2) : "–"], ...COUNTERS.map(([key, name]) => [name, count(frames[key])])];
    if (zero) rows.push(["zero of blocks", zero]);
    if (this.counters.childElementCount !== rows.length) this.counters.replaceChildren(...rows.map(([name]) => counter(name)));
    rows.forEach(([, value], place) => write(this.counters.children[place].lastChild, value));
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
      const place = Math.floor((block - bus.first_block) / bus.blocks_per_node);
      if (place >= 0 && place < bus.nodes) return `${bus.name} node ${this.tiles[block].textContent}`;
    }
    return "";
  }

  state(block) {
    return this.tiles[block].dataset.state ?? "unknown";
  }
}

// What a person must be told, and which services are there.

import { clock, make, span } from "./words.js";

const EXPECTED = ["gateway", "reconstructor", "classifier"];
const WORD = { gone: "gone", unreached: "out of reach", unseen: "not seen" };
const bar = document.getElementById("notices");
const list = document.getElementById("services");
let written = "";

/** Show notices; one that began at a known time says since when and for how long. */
export function drawNotices(notices, time_s) {
  const lines = notices.map(({ level, text, since_time_s }) => {
    const since = since_time_s === null ? "" : ` (since ${clock(since_time_s)}, ${span(Math.max(0, Math.floor(time_s - since_time_s)))})`;
    return { level, text: text + since };
  });
  const wanted = JSON.stringify(lines);
  if (wanted === written) return;
  written = wanted;
  bar.replaceChildren(...lines.map(({ level, text }) => make("p", level, text)));
}

/** One chip per service: there, gone, out of reach with the whole fabric, or not seen yet. */
export function drawServices({ services, cut_off: isCutOff }) {
  const names = [...EXPECTED, ...Object.keys(services).filter((name) => name.startsWith("nodes"))];
  const state = (name) => (services[name] ? (services[name].alive ? "there" : isCutOff ? "unreached" : "gone") : "unseen");
  const chips = names.map((name) => ({ name, state: state(name) }));
  const wanted = JSON.stringify(chips);
  if (list.dataset.written === wanted) return;
  list.dataset.written = wanted;
  list.replaceChildren(...chips.map(({ name, state }) => {
    const chip = make("li", state, name);
    if (state !== "there") chip.append(make("small", "", WORD[state]));
    return chip;
  }));
}

// The notices, and the services.

import { clock, make, span } from "./words.js";

const EXPECTED = ["gateway", "reconstructor", "classifier"];
const WORD = { gone: "gone", silent: "sends nothing", differs: "of another Φ", unreached: "out of reach", unseen: "not seen" };
const bar = document.getElementById("notices");
const list = document.getElementById("services");
let written = "";

/** Show notices; a notice with a known begin shows that time and the duration. */
export function drawNotices(notices, time_s) {
  const lines = notices.map(({ level, code, text, mend, since_time_s }) => {
    const since = since_time_s === null ? "" : ` (since ${clock(since_time_s)}, ${span(Math.max(0, Math.floor(time_s - since_time_s)))})`;
    return { level, text: text + since, title: `${code}: ${mend}` };
  });
  const wanted = JSON.stringify(lines);
  if (wanted === written) return;
  written = wanted;
  bar.replaceChildren(...lines.map(({ level, text, title }) => Object.assign(make("p", level, text), { title })));
}

/** State of a service: there, silent, differs, gone, unreached (the viewer has lost the hub), or unseen. */
function state(service, isCutOff) {
  if (!service) return "unseen";
  if (!service.alive) return isCutOff ? "unreached" : "gone";
  if (service.difference) return "differs";
  return service.silent ? "silent" : "there";
}

const SCHEDULING = { realtime: "real-time scheduling", ordinary: "ordinary scheduling: late when the cores are full" };
const about = (service) =>
  [service?.version && `canskin ${service.version}`, service?.fingerprint && `Φ ${service.fingerprint}`, SCHEDULING[service?.scheduling]]
    .filter(Boolean).join(", ");

/** One chip per service; its title shows the version, Φ and scheduling of the service. */
export function drawServices({ services, cut_off: isCutOff, playback }) {
  const names = playback ? [] : [...EXPECTED, ...Object.keys(services).filter((name) => name.startsWith("nodes") || (name === "recorder" && services[name].alive))];
  const chips = names.map((name) => ({ name, state: state(services[name], isCutOff), title: about(services[name]) }));
  const wanted = JSON.stringify(chips);
  if (list.dataset.written === wanted) return;
  list.dataset.written = wanted;
  list.replaceChildren(...chips.map(({ name, state, title }) => {
    const chip = make("li", state, name);
    chip.title = title;
    if (state !== "there") chip.append(make("small", "", WORD[state]));
    return chip;
  }));
}

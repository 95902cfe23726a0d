// The figures above the images.

import { fixed, percent, span, spoken, write } from "./words.js";

const parts = (id) => {
  const root = document.getElementById(id);
  return { root, value: root.querySelector(".value"), detail: root.querySelector(".detail") };
};

function set(id, value, detail, { stale = false, alert = false } = {}) {
  const figure = parts(id);
  write(figure.value, value);
  write(figure.detail, detail);
  figure.root.classList.toggle("stale", stale);
  figure.root.classList.toggle("alert", alert);
}

function drawObject({ label, truth }) {
  const meter = document.querySelector("#object .meter > div");
  const said = label && label.measured && label.label;
  const really = truth && !truth.stale ? (truth.label ? `truth: ${spoken(truth.label)}` : "truth: none or unnamed") : "";
  const value = !label ? "–" : !label.measured ? "not measured" : said ? spoken(said) : "no contact";
  if (!label) set("object", value, "no label yet", { stale: true });
  else if (label.stale) set("object", value, `said ${span(label.age_s)} ago`, { stale: true });
  else if (!label.measured) set("object", value, ["too few sums came", really].filter(Boolean).join(" · "), { stale: true });
  else {
    const sure = said ? `${percent(label.confidence)} sure` : "";
    set("object", value, [sure, really].filter(Boolean).join(" · "));
  }
  meter.style.width = said ? `${100 * label.confidence}%` : "0";
  document.getElementById("object").classList.toggle("empty", !said);
}

/** Text below the PSNR: the sensor's PSNR and the difference, if the sensor adds noise. */
function comparison({ figures, truth }, stale) {
  const { psnr_image_db: image, psnr_sensor_db: sensor, sensor_adds_noise: isNoisy } = figures;
  if (!truth) return "no truth published";
  if (image === null) return stale ? "no image in the last second" : "no contact in the last second";
  if (!isNoisy) return "against a truth without noise";
  return `sensor ${fixed(sensor, 1)} dB · ${image < sensor ? "−" : "+"}${Math.abs(image - sensor).toFixed(1)} dB`;
}

/** Text of the SYNC rate and of the buses that SYNC reaches. */
function sync(gateway) {
  if (!gateway) return "no gateway";
  if (gateway.stale) return "SYNC unknown";
  const reached = gateway.buses.filter(({ synced }) => synced).length;
  if (reached === 0) return "SYNC reaches no bus";
  const where = reached < gateway.buses.length ? ` on ${reached} of ${gateway.buses.length} buses` : "";
  return `SYNC ${fixed(gateway.sync_rate_hz, 1)} Hz${where}`;
}

/** Write all figures of a snapshot. */
export function drawFigures(snapshot) {
  const { figures, gateway, image } = snapshot;
  const stale = !image || image.stale;
  drawObject(snapshot);

  const nothing = stale || image.valid_sums === 0;
  const psnr = nothing || figures.psnr_image_db === null ? "–" : `${fixed(figures.psnr_image_db, 1)} dB`;
  set("psnr", psnr, comparison(snapshot, stale), { stale });
  set("rate", nothing ? "–" : `${fixed(figures.images_hz, 1)} /s`, sync(gateway), { stale });

  const ms = (seconds) => (seconds === null ? "–" : `${(1000 * seconds).toFixed(1)} ms`);
  const isTimed = !nothing && figures.latency_p99_s !== null;
  const detail = isTimed ? `p99 ${ms(figures.latency_p99_s)} · solver ${ms(image.solve_s)}` : nothing && image ? "nothing is measured" : "";
  set("latency", ms(isTimed ? figures.latency_p50_s : null), detail, { stale });

  const low = stale ? null : figures.valid_blocks_low;
  const missing = low !== null && low < figures.blocks;
  const fewest = low === null ? "" : missing ? `${figures.blocks - low} missing within 1 s` : "none missing within 1 s";
  set("blocks", `${stale ? "–" : figures.valid_blocks} / ${figures.blocks}`, fewest, { stale, alert: missing });
}

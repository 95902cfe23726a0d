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
  const said = label && label.label;
  const really = truth && !truth.stale ? (truth.label ? `truth: ${spoken(truth.label)}` : "truth: none or unnamed") : "";
  if (!label) set("object", "–", "no label yet", { stale: true });
  else if (label.stale) set("object", said ? spoken(said) : "no contact", `said ${span(label.age_s)} ago`, { stale: true });
  else if (label.blind) set("object", "–", "too few sums to tell", { stale: true });
  else {
    const sure = said ? `${percent(label.confidence)} sure` : "";
    set("object", said ? spoken(said) : "no contact", [sure, really].filter(Boolean).join(" · "));
  }
  meter.style.width = said ? `${100 * label.confidence}%` : "0";
  document.getElementById("object").classList.toggle("empty", !said);
}

/** Write all figures of a snapshot. */
export function drawFigures(snapshot) {
  const { figures, gateway, image } = snapshot;
  const stale = !image || image.stale;
  drawObject(snapshot);

  const gain = figures.psnr_image_db !== null ? figures.psnr_image_db - figures.psnr_sensor_db : null;
  const nothing = stale ? "no image in the last second" : "no contact in the last second";
  const against = gain === null
    ? (snapshot.truth ? nothing : "no truth published")
    : `sensor ${fixed(figures.psnr_sensor_db, 1)} dB · ${gain < 0 ? "−" : "+"}${Math.abs(gain).toFixed(1)} dB`;
  set("psnr", gain === null ? "–" : `${fixed(figures.psnr_image_db, 1)} dB`, against, { stale });

  const sync = gateway ? `SYNC ${fixed(gateway.sync_rate_hz, 1)} Hz` : "no gateway";
  set("rate", image ? `${fixed(figures.images_hz, 1)} /s` : "–", sync, { stale });

  const ms = (seconds) => (seconds === null ? "–" : `${(1000 * seconds).toFixed(1)} ms`);
  const solve = image ? ` · solver ${ms(image.solve_s)}` : "";
  set("latency", ms(figures.latency_p50_s), figures.latency_p99_s === null ? "" : `p99 ${ms(figures.latency_p99_s)}${solve}`, { stale });

  const low = figures.valid_blocks_low === null ? "" : `fewest in the last second ${figures.valid_blocks_low}`;
  const missing = !stale && figures.valid_blocks_low !== null && figures.valid_blocks_low < figures.blocks;
  set("blocks", `${figures.valid_blocks ?? "–"} / ${figures.blocks}`, low, { stale, alert: missing });
}

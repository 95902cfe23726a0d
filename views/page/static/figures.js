// The figures above the images. A figure that a run does not have is not shown.

import { hasCentre } from "./contacts.js";
import { fixed, force, percent, spaced, span, spoken, write } from "./words.js";

const ms = (seconds) => (seconds === null ? "–" : `${(1000 * seconds).toFixed(1)} ms`);

/** Text below the PSNR: that of one raw sample and the difference, if the sensor adds noise. */
function comparison({ figures, truth }, stale) {
  const { psnr_image_db: image, psnr_sensor_db: sensor, sensor_adds_noise: isNoisy } = figures;
  if (!truth && image === null) return "no truth of this cycle";
  if (image === null) return stale ? "no image in the last second" : "no contact in the last second";
  if (!isNoisy) return "against a truth without noise";
  return `raw ${fixed(sensor, 1)} dB · ${image < sensor ? "−" : "+"}${Math.abs(image - sensor).toFixed(1)} dB`;
}

/** Text of the SYNC rate and of the buses that SYNC reaches. */
function sync(gateway) {
  if (!gateway) return "";
  if (gateway.stale) return "SYNC unknown";
  const reached = gateway.buses.filter(({ synced }) => synced).length;
  if (reached === 0) return "SYNC reaches no bus";
  const where = reached < gateway.buses.length ? ` on ${reached} of ${gateway.buses.length} buses` : "";
  return `SYNC${gateway.sync_rate_hz ? ` ${fixed(gateway.sync_rate_hz, 1)} Hz` : ""}${where}`;
}

/** Text below the total force. */
function pressure(snapshot, { row, column, position_m, threshold_n, is_over: isOver, is_doubtful: isDoubtful, force_n }) {
  const limit = threshold_n === null ? "" : `${isOver ? "over" : "threshold"} ${force(threshold_n)}`;
  const doubt = isDoubtful ? "in doubt" : "";
  const isPlaced = hasCentre(snapshot) && row !== null && force_n > 0;
  const place = snapshot.isGrid ? `centre row ${row?.toFixed(1)}, column ${column?.toFixed(1)}` : position_m && spaced(position_m);
  return [limit, doubt, isPlaced ? place : "", !isPlaced && !doubt && snapshot.contacts ? "nothing touches" : ""].filter(Boolean).join(" · ");
}

export class Figures {
  constructor(skin) {
    this.isGrid = !skin.surface;
    this.parts = Object.fromEntries(
      [...document.querySelectorAll(".figure")].map((root) => {
        root.hidden = true;
        return [root.id, { root, value: root.querySelector(".value"), detail: root.querySelector(".detail") }];
      }),
    );
  }

  /** Write a figure; it appears when the run has it for the first time. */
  set(id, isThere, value, detail, { stale = false, alert = false, doubtful = false } = {}) {
    const figure = this.parts[id];
    if (isThere) figure.root.hidden = false;
    write(figure.value, value);
    write(figure.detail, detail);
    figure.detail.title = detail;
    figure.root.classList.toggle("stale", stale);
    figure.root.classList.toggle("alert", alert);
    figure.root.classList.toggle("doubtful", doubtful);
  }

  /** Write all figures of a snapshot; `hasTruth` tells whether the run has true images. */
  draw(snapshot, hasTruth) {
    const { figures, gateway, image, patches } = snapshot;
    const stale = !image || image.stale;
    this.drawObject(snapshot);

    const nothing = stale || image.valid_sums === 0;
    const skin = patches[0];
    if (skin) {
      const isMeasured = skin.force_n !== null && !nothing;
      const detail = skin.force_n === null ? "nothing is measured" : pressure({ ...snapshot, isGrid: this.isGrid }, skin);
      const state = { stale, alert: skin.is_over && isMeasured, doubtful: skin.is_doubtful };
      this.set("force", true, isMeasured ? force(skin.force_n) : "–", stale ? "" : detail, state);
    } else this.set("force", false, "–", "", { stale: true }); // an instant before the first image
    const hasPsnr = !nothing && figures.psnr_image_db !== null;
    this.parts.psnr.root.hidden = !hasTruth;
    this.set("psnr", hasTruth, hasPsnr ? `${fixed(figures.psnr_image_db, 1)} dB` : "–", comparison(snapshot, stale), { stale });
    this.set("rate", image, nothing ? "–" : `${fixed(figures.images_hz, 1)} /s`, sync(gateway), { stale, alert: !stale && gateway?.buses.some(({ synced }) => !synced) });

    const isTimed = !nothing && figures.latency_p99_s !== null;
    const detail = isTimed ? `p99 ${ms(figures.latency_p99_s)} · solver ${ms(image.solve_s)}` : image && !stale ? "nothing is measured" : "";
    this.set("latency", isTimed, ms(isTimed ? figures.latency_p50_s : null), detail, { stale });

    const low = stale ? null : figures.valid_blocks_low;
    const missing = low !== null && low < figures.blocks;
    const fewest = low === null ? "" : missing ? `${figures.blocks - low} missing within 1 s` : "none missing within 1 s";
    this.set("blocks", image, `${stale ? "–" : figures.valid_blocks} / ${figures.blocks}`, fewest, { stale, alert: missing });
  }

  drawObject({ label, truth, services }) {
    const said = label && label.measured && label.label;
    const really = truth && !truth.stale ? (truth.label ? `truth: ${spoken(truth.label)}` : "truth: none or unnamed") : "";
    const value = !label ? "–" : !label.measured ? "not measured" : said ? spoken(said) : "no contact";
    const isThere = label || services.classifier;
    if (!label) this.set("object", isThere, value, "no label yet", { stale: true });
    else if (label.stale) this.set("object", true, value, `said ${span(label.age_s)} ago`, { stale: true });
    else if (!label.measured) this.set("object", true, value, ["too few sums came", really].filter(Boolean).join(" · "), { stale: true });
    else this.set("object", true, value, [said ? `${percent(label.confidence)} sure` : "", really].filter(Boolean).join(" · "));
    const { root } = this.parts.object;
    root.querySelector(".meter > div").style.width = said ? `${100 * label.confidence}%` : "0";
    root.classList.toggle("empty", !said);
  }
}

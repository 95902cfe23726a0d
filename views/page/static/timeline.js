// History as tracks over time, and the instant that the page shows: now, one of the past, or a place in a recording.

import { curve, inks, pieces, prepared } from "./curves.js";
import { roundUp } from "./colour.js";
import { clock, clockTenths, force, make, percent, span, spoken, stopwatch, write } from "./words.js";

// Time shown of a running skin: the shortest of these that has room for all moments.
const SPANS_S = [60, 120, 300];
const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10];
const FULL_LOAD = 0.95;
const AXIS_PX = 16;
const GAP_PX = 5;
// Smallest top of a track, in its unit.
const TRACKS = [
  { key: "force_n", name: "Force", px: 44, least: 0.1, words: force, isFilled: true },
  { key: "latency_s", name: "Latency", px: 24, least: 0.01, words: (value) => `${(1000 * value).toFixed(1)} ms` },
  { key: "load_ratio", name: "Load", px: 24, least: 1, words: (value) => percent(value, 1) },
  { key: "lost", name: "Frames lost", px: 24, least: 4, words: (value) => String(value), isBar: true },
  { key: "label", name: "Label", px: 20, words: (value) => (value ? spoken(value) : "none"), isBand: true },
  { key: "mark", name: "Mark", px: 20, words: (value) => value || "none", isBand: true },
];
// Steps between the times on the axis, seconds, and their least distance.
const STEPS_S = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1800, 3600];
const STEP_PX = 70;

// In a window with room for the history beside the images the curves grow with its height, up to `MOST_TIMES`.
const BROAD = matchMedia("(min-width: 1700px)");
const LOW_PX = 1100;
const TIMES_PX = 220;
const MOST_TIMES = 3;

const isKnown = (value) => value !== null && value !== undefined;

export class Timeline {
  /**
   * `show()` is called when another instant is to be drawn, `fetchFrame(time_s)` returns the frame of an instant or
   * null, and `play(request)` moves a recording.
   */
  constructor(history, { show, fetchFrame, play }) {
    Object.assign(this, { history, show, fetchFrame, play });
    const part = (id) => document.getElementById(id);
    [this.root, this.instant, this.scrub, this.button] = ["time", "instant", "scrub", "pause"].map(part);
    this.canvas = this.scrub.querySelector("canvas");
    this.cursor = this.scrub.querySelector("i");
    this.list = this.root.querySelector("dl");
    this.past = null;
    this.playback = null;
    this.button.onclick = () => this.toggle();
    this.speed = part("speed").querySelector("select");
    this.speed.replaceChildren(...SPEEDS.map((speed) => new Option(`${speed} ×`, speed, speed === 1, speed === 1)));
    this.speed.onchange = () => play({ speed: Number(this.speed.value) });
    this.letScrub();
    this.width = 0;
    new ResizeObserver(([{ contentRect }]) => {
      if (contentRect.width === this.width) return;
      this.width = contentRect.width;
      this.drawTracks();
    }).observe(this.scrub);
  }

  letScrub() {
    const { scrub } = this;
    const at = ({ clientX }) => {
      const { left, width } = scrub.getBoundingClientRect();
      const [from_s, to_s] = this.range();
      return from_s + ((to_s - from_s) * (clientX - left)) / width;
    };
    scrub.onpointerdown = (event) => {
      scrub.setPointerCapture(event.pointerId);
      this.goTo(at(event));
    };
    scrub.onpointermove = (event) => event.buttons && this.goTo(at(event));
    scrub.onkeydown = (event) => {
      const [from_s, to_s] = this.range();
      if (event.key === "Home") this.goTo(from_s);
      else if (event.key === "End") this.playback ? this.goTo(to_s) : this.goLive();
      else return;
      event.preventDefault();
    };
  }

  /** Times at both ends of the tracks. */
  range() {
    if (this.playback) return [this.origin_s, this.origin_s + this.playback.duration_s];
    const { moments, end_s } = this.history;
    const to_s = this.past?.end_s ?? end_s ?? 0;
    const long_s = moments.length ? to_s - moments[0].time_s : 0;
    return [to_s - (SPANS_S.find((each) => each >= long_s) ?? SPANS_S.at(-1)), to_s];
  }

  /** Time of what is shown. */
  get time_s() {
    if (this.playback) return this.origin_s + this.playback.position_s;
    return this.past?.time_s ?? this.history.end_s;
  }

  toggle() {
    if (this.playback) this.play({ is_paused: !this.playback.is_paused });
    else if (this.past) this.goLive();
    else if (this.history.end_s !== null) this.goTo(this.history.end_s);
  }

  goLive() {
    if (!this.past) return;
    this.past = null;
    this.drawTracks();
    this.show();
  }

  step(seconds) {
    if (this.time_s !== null) this.goTo(this.time_s + seconds);
  }

  /** Show an instant: of the last minutes, which holds the page, or of the recording. */
  goTo(time_s) {
    const [from_s, to_s] = this.range();
    const wanted_s = Math.max(from_s, Math.min(to_s, time_s));
    if (this.playback) this.playback.position_s = wanted_s - this.origin_s;
    else this.past = { frame: this.history.frame, isMissing: false, end_s: to_s, ...this.past, time_s: wanted_s };
    this.wanted_s = wanted_s;
    this.bring();
    this.drawState();
  }

  /** Bring the frame that is wanted; while one is under way the newest wish waits. */
  async bring() {
    if (this.isBringing) return;
    this.isBringing = true;
    while (this.wanted_s !== null) {
      const time_s = this.wanted_s;
      this.wanted_s = null;
      if (this.playback) await this.play({ position_s: Math.max(0, time_s - this.origin_s) });
      else {
        const frame = await this.fetchFrame(time_s);
        if (this.past) Object.assign(this.past, { frame: frame ?? this.past.frame, isMissing: !frame });
      }
      this.show();
    }
    this.isBringing = false;
  }

  /** Draw where the page is; `snapshot` is the newest, and `now_s` the time at the server. */
  draw(snapshot) {
    this.now_s = snapshot.time_s;
    const { playback } = snapshot;
    if (playback) this.origin_s = snapshot.time_s - playback.position_s;
    // Until it is there, the place where the user is going is shown.
    const { position_s } = (this.isBringing && this.playback) || playback || {};
    this.playback = playback && { ...playback, position_s };
    this.drawState();
  }

  drawState() {
    const { past, playback } = this;
    write(this.button, playback ? (playback.is_paused ? "Go on" : "Hold") : past ? "Live" : "Pause");
    document.body.classList.toggle("past", Boolean(past));
    this.speed.parentElement.hidden = !playback;
    if (playback && document.activeElement !== this.speed) this.speed.value = playback.speed;
    write(this.instant, this.words());
    const [from_s, to_s] = this.range();
    const share = this.time_s === null ? 1 : (this.time_s - from_s) / Math.max(to_s - from_s, 1e-3);
    this.cursor.hidden = !past && !playback;
    this.cursor.style.transform = `translateX(${(share * this.width).toFixed(1)}px)`;
    this.scrub.ariaValueMax = String(Math.round(to_s - from_s));
    this.scrub.ariaValueNow = String(Math.round(share * (to_s - from_s)));
    this.scrub.ariaValueText = this.words();
  }

  /** The instant shown, in words. */
  words() {
    const { past, playback } = this;
    if (playback) {
      const where = `${stopwatch(playback.position_s, 1)} of ${stopwatch(playback.duration_s, 1)}`;
      return `${where} · ${new Date(1000 * this.time_s).toLocaleDateString("en-GB")}, ${clockTenths(this.time_s)}`;
    }
    if (this.now_s === undefined) return "";
    if (!past) return `now · ${clock(this.now_s)}`;
    return `${clockTenths(this.shown_s)}, ${span(this.now_s - this.shown_s)} ago`;
  }

  /** Time of the frame shown, which is the nearest that is kept. */
  get shown_s() {
    const { frame, isMissing, time_s } = this.past;
    return frame && !isMissing ? frame.snapshot.time_s : time_s;
  }

  /** Write the values of the instant of a snapshot; frames lost are those of the last tenth of a second. */
  drawValues({ time_s, moment }) {
    const values = { lost: this.history.at(time_s)?.lost, ...moment };
    for (const { key, words, value } of this.rows ?? []) write(value, isKnown(values[key]) ? words(values[key]) : "");
  }

  /** Draw the curves anew: moments have come, or the place has another size or other colours. */
  drawTracks() {
    const { moments } = this.history;
    const times = BROAD.matches ? Math.max(1, Math.min(MOST_TIMES, 1 + (innerHeight - LOW_PX) / TIMES_PX)) : 1;
    const tracks = TRACKS.filter(({ key }) => moments.some((moment) => isKnown(moment[key]))).map((track) => (track.isBand ? track : { ...track, px: Math.round(track.px * times) }));
    this.root.classList.toggle("empty", !tracks.length);
    this.arrange(tracks);
    const height = tracks.reduce((sum, { px }) => sum + px + GAP_PX, AXIS_PX);
    this.canvas.style.height = `${height}px`;
    if (!tracks.length || !this.width) return;
    const [brush, width] = prepared(this.canvas, height);
    const [from_s, to_s] = this.range();
    const x = (time_s) => ((time_s - from_s) / Math.max(to_s - from_s, 1e-3)) * width;
    const shown = this.history.between(from_s, to_s);
    const ink = inks();
    this.drawAxis(brush, { x, from_s, to_s, width, height, ink });
    let top = 0;
    for (const track of tracks) {
      brush.save();
      brush.translate(0, top);
      const points = shown.map((moment) => [moment.time_s, moment[track.key]]);
      if (track.isBand) drawBand(brush, points, x, { ...track, ink });
      else drawTrack(brush, points, x, { ...track, width, ink });
      brush.restore();
      top += track.px + GAP_PX;
    }
    this.drawState();
  }

  /** Name the tracks beside them. */
  arrange(tracks) {
    const wanted = tracks.map(({ key, px }) => `${key} ${px}`).join();
    if (wanted === this.arranged) return;
    this.arranged = wanted;
    this.rows = tracks.map((track) => ({ ...track, value: make("dd") }));
    this.list.replaceChildren(
      ...this.rows.map(({ name, px, value }) => {
        const row = make("div");
        row.style.height = `${px + GAP_PX}px`;
        row.append(make("dt", "", name), value);
        return row;
      }),
    );
  }

  drawAxis(brush, { x, from_s, to_s, width, height, ink }) {
    const step_s = STEPS_S.find((each) => x(from_s + each) - x(from_s) >= STEP_PX) ?? STEPS_S.at(-1);
    const begin_s = this.playback ? this.origin_s : new Date(1000 * from_s).setHours(0, 0, 0, 0) / 1000;
    brush.font = '11px system-ui, "Segoe UI", "DejaVu Sans", sans-serif';
    brush.fillStyle = ink.muted;
    brush.strokeStyle = ink.line;
    brush.lineWidth = 1;
    for (let number = Math.ceil((from_s - begin_s) / step_s); begin_s + number * step_s <= to_s; number++) {
      const at = Math.round(x(begin_s + number * step_s)) + 0.5;
      const text = this.playback ? stopwatch(number * step_s) : clock(begin_s + number * step_s);
      const wide = brush.measureText(text).width;
      brush.beginPath();
      brush.moveTo(at, 0);
      brush.lineTo(at, height - AXIS_PX);
      brush.stroke();
      brush.fillText(text, Math.max(0, Math.min(width - wide, at - wide / 2)), height - 3);
    }
  }
}

function drawTrack(brush, points, x, { px, least, width, ink, isFilled, isBar, key }) {
  const most = points.reduce((high, [, value]) => Math.max(high, value ?? 0), least);
  const top = key === "load_ratio" ? Math.max(1, most) : roundUp(most);
  const y = (value) => px - (Math.max(0, value) / top) * (px - 2);
  brush.strokeStyle = ink.line;
  brush.lineWidth = 1;
  brush.strokeRect(0, px + 0.5, width, 0);
  if (isBar) {
    brush.fillStyle = ink.warning;
    for (const piece of pieces(points, x)) {
      for (const [at, , high] of piece) {
        const tip = Math.min(px - 3, y(high));
        if (high > 0) brush.fillRect(Math.floor(at) - 1, tip, 2, px - tip);
      }
    }
    return;
  }
  curve(brush, points, { x, y, stroke: ink.accent, fill: isFilled ? ink["accent-soft"] : null, base: px });
  if (key === "load_ratio") {
    const full = points.map(([time_s, value]) => [time_s, value > FULL_LOAD ? value : null]);
    curve(brush, full, { x, y, stroke: ink.error });
  }
}

/** Draw what was named, as long as it was. */
function drawBand(brush, points, x, { px, words, ink }) {
  brush.font = '11px system-ui, "Segoe UI", "DejaVu Sans", sans-serif';
  for (let first = 0, last = 0; first < points.length; first = last + 1) {
    const label = points[first][1];
    last = first;
    while (last + 1 < points.length && points[last + 1][1] === label && points[last + 1][0] - points[last][0] < 0.35) last++;
    if (!isKnown(label)) continue;
    const left = x(points[first][0]);
    const wide = Math.max(1, x(points[last][0] + 0.1) - left);
    brush.fillStyle = label ? ink["accent-soft"] : ink.track;
    brush.fillRect(left, label ? 0 : px - 3, wide - (wide > 3 ? 1 : 0), label ? px : 3);
    const text = label && words(label);
    if (!text || brush.measureText(text).width > wide - 8) continue;
    brush.fillStyle = ink.text;
    brush.fillText(text, left + 4, px - 6);
  }
}

// The curves of the last minutes, or of a recording as far as it has been played: ten moments a second.

const POLL_MS = 400;
// Moments of a running skin that are kept; the server keeps five minutes, and a pause holds those before it.
const KEPT_S = 900;
// In a recording that was moved, the server has moments from shortly before the position on.
const OVERLAP_S = 0.35;
const BEFORE_S = 3;

export class History {
  /** `changed()` is called when moments have come. */
  constructor(changed) {
    this.changed = changed;
    this.clear();
    setInterval(() => this.ask(), POLL_MS);
  }

  clear() {
    this.moments = []; // by time
    this.askedAt_s = null; // time of the newest frame when the last question was asked
    this.frame = null;
  }

  get end_s() {
    return this.moments.at(-1)?.time_s ?? null;
  }

  async ask() {
    if (this.isAsking || !this.frame || document.hidden) return;
    this.isAsking = true;
    try {
      const { time_s, playback } = this.frame.snapshot;
      const wasMoved = playback && this.askedAt_s !== null && time_s < this.askedAt_s;
      const after_s = playback ? (wasMoved ? time_s - BEFORE_S : (this.askedAt_s ?? 0) - OVERLAP_S) : (this.end_s ?? 0);
      this.askedAt_s = time_s;
      const answer = await fetch(`api/history?after_s=${after_s}`);
      if (answer.ok) this.take(await answer.json());
    } catch {
      // the page tells that the connection is lost
    } finally {
      this.isAsking = false;
    }
  }

  take(columns) {
    const names = Object.keys(columns);
    const came = columns.time_s.map((_, place) => Object.fromEntries(names.map((name) => [name, columns[name][place]])));
    if (!came.length) return;
    const [first_s, last_s] = [came[0].time_s, came.at(-1).time_s];
    if (this.end_s === null || first_s > this.end_s) this.moments.push(...came);
    else {
      const others = this.moments.filter(({ time_s }) => time_s < first_s || time_s > last_s);
      this.moments = [...others, ...came].sort((one, other) => one.time_s - other.time_s);
    }
    const isLive = !this.frame?.snapshot.playback;
    if (isLive && this.moments[0].time_s < last_s - KEPT_S) this.moments.splice(0, this.placeOf(last_s - KEPT_S));
    this.changed();
  }

  /** Place of the first moment that is not before a time. */
  placeOf(time_s) {
    let [low, high] = [0, this.moments.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.moments[middle].time_s < time_s) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  between(from_s, to_s) {
    return this.moments.slice(this.placeOf(from_s), this.placeOf(to_s + 1e-6));
  }

  /** The moment of a time, or the one shortly before; null if nothing is known of it. */
  at(time_s) {
    const found = this.moments[this.placeOf(time_s + 1e-6) - 1];
    return found && time_s - found.time_s < 1 ? found : null;
  }
}

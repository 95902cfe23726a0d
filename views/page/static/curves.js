// Curves on canvases. A gap of the measurement is a gap of the curve.

// Moments come every 0.1 s; a longer time without one is a gap.
const GAP_S = 0.35;

const INKS = ["accent", "accent-soft", "warning", "error", "text", "muted", "line", "track"];
// As colours, and not as texts, the properties have the values of the scheme that is shown.
for (const name of INKS) CSS.registerProperty({ name: `--${name}`, syntax: "<color>", inherits: true, initialValue: "gray" });

/** Colours of the page as they are now, by name. */
export function inks() {
  const style = getComputedStyle(document.documentElement);
  return Object.fromEntries(INKS.map((name) => [name, style.getPropertyValue(`--${name}`)]));
}

/** Give a canvas the device pixels of its place on the page; returns its brush, and width and height in CSS pixels. */
export function prepared(canvas, height) {
  const width = canvas.clientWidth;
  const [wide, high] = [Math.round(width * devicePixelRatio), Math.round(height * devicePixelRatio)];
  if (canvas.width !== wide || canvas.height !== high) [canvas.width, canvas.height] = [wide, high];
  const brush = canvas.getContext("2d");
  brush.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
  brush.clearRect(0, 0, width, height);
  return [brush, width, height];
}

/**
 * Cut points of time and value into pieces without gaps; of the points of one column of pixels the lowest and the
 * highest value stay. `x(time_s)` is in pixels. Returns lists of [x, lowest, highest].
 */
export function pieces(points, x) {
  const found = [];
  let last_s = -Infinity;
  for (const [time_s, value] of points) {
    if (value === null || value === undefined) {
      last_s = -Infinity;
      continue;
    }
    if (time_s - last_s > GAP_S) found.push([]);
    const piece = found.at(-1);
    const column = x(time_s);
    const newest = piece.at(-1);
    if (newest && Math.floor(newest[0]) === Math.floor(column)) {
      newest[1] = Math.min(newest[1], value);
      newest[2] = Math.max(newest[2], value);
    } else piece.push([column, value, value]);
    last_s = time_s;
  }
  return found;
}

/** Draw a curve; `y(value)` is in pixels. With `fill` the area down to `base` is filled. */
export function curve(brush, points, { x, y, stroke, fill = null, base = 0, isDashed = false }) {
  brush.lineWidth = 1.5;
  brush.lineJoin = "round";
  brush.setLineDash(isDashed ? [3, 3] : []);
  for (const piece of pieces(points, x)) {
    const line = new Path2D();
    for (const [at, low, high] of piece) {
      line.lineTo(at, y(low));
      if (high > low) line.lineTo(at, y(high));
    }
    if (piece.length === 1) line.lineTo(piece[0][0] + 1, y(piece[0][1])); // one moment between gaps is seen, too
    if (fill) {
      const area = new Path2D(line);
      area.lineTo(piece.at(-1)[0], base);
      area.lineTo(piece[0][0], base);
      brush.fillStyle = fill;
      brush.fill(area);
    }
    brush.strokeStyle = stroke;
    brush.stroke(line);
  }
  brush.setLineDash([]);
}

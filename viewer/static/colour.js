// A perceptually uniform colour map: equal steps of force are equal steps in OKLab (B. Ottosson, 2020).
// The path runs from near-black blue over teal to pale yellow. Lightness rises evenly, so the map works in grey and for
// every colour vision. The path is cut into pieces of equal length.

const STEPS = 256;
const SAMPLES = 2048;

/** OKLCH (hue in degrees) to linear sRGB. */
function linearFrom(lightness, chroma, hue) {
  const a = chroma * Math.cos((hue * Math.PI) / 180);
  const b = chroma * Math.sin((hue * Math.PI) / 180);
  const l = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3;
  const m = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const s = (lightness - 0.0894841775 * a - 1.291485548 * b) ** 3;
  return [
    4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
    -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
    -0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s,
  ];
}

const inGamut = (rgb) => rgb.every((part) => part >= -1e-4 && part <= 1 + 1e-4);

/** The path's colour at `t` from 0 to 1, with as much chroma as sRGB can show. */
function pathAt(t) {
  const lightness = 0.17 + 0.79 * t;
  const hue = 285 - 180 * t ** 1.15;
  let chroma = 0.045 + 0.072 * Math.sin(Math.PI * Math.min(1, 0.12 + 0.85 * t));
  while (chroma > 0 && !inGamut(linearFrom(lightness, chroma, hue))) chroma -= 0.002;
  const radians = (hue * Math.PI) / 180;
  return { lab: [lightness, chroma * Math.cos(radians), chroma * Math.sin(radians)], rgb: linearFrom(lightness, chroma, hue) };
}

function encode(linear) {
  const part = Math.min(1, Math.max(0, linear));
  return Math.round(255 * (part <= 0.0031308 ? 12.92 * part : 1.055 * part ** (1 / 2.4) - 0.055));
}

function build() {
  const path = Array.from({ length: SAMPLES }, (_, index) => pathAt(index / (SAMPLES - 1)));
  const length = [0];
  for (let index = 1; index < SAMPLES; index++) {
    const [one, other] = [path[index - 1].lab, path[index].lab];
    length.push(length[index - 1] + Math.hypot(one[0] - other[0], one[1] - other[1], one[2] - other[2]));
  }
  const table = new Uint8Array(STEPS * 3);
  for (let step = 0, index = 0; step < STEPS; step++) {
    const wanted = (step / (STEPS - 1)) * length[SAMPLES - 1];
    while (index < SAMPLES - 1 && length[index] < wanted) index++;
    table.set(path[index].rgb.map(encode), step * 3);
  }
  return table;
}

/** 256 colours, red, green, blue in turn. */
export const COLOURS = build();

/** Index into COLOURS of `value` on a scale from 0 to `top`. */
export const colourIndex = (value, top) => Math.max(0, Math.min(STEPS - 1, Math.round((value / top) * (STEPS - 1))));

/** The next of 1, 1.5, 2, 3, 4, 5, 6, 8, 10, 15 … that is not below `value`. */
export function roundUp(value) {
  const decade = 10 ** Math.floor(Math.log10(value));
  return [1, 1.5, 2, 3, 4, 5, 6, 8, 10].map((step) => step * decade).find((step) => step >= value * 0.999999);
}

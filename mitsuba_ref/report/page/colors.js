// Colours. Maps are straight or bent lines through OKLab (Ottosson 2020), where equal steps look equally large.

/** OKLab -> sRGB, three numbers from 0 to 255. */
function fromOklab(light, a, b) {
  const l = (light + 0.3963377774 * a + 0.2158037573 * b) ** 3;
  const m = (light - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const s = (light - 0.0894841775 * a - 1.291485548 * b) ** 3;
  return [
    4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
    -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
    -0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s,
  ].map(gamma);
}

function gamma(linear) {
  const c = Math.min(1, Math.max(0, linear));
  return Math.round(255 * (c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055));
}

/** 256 colours: lightness, chroma and hue (degrees) as functions from 0..1. */
function table(light, chroma, hue) {
  return Array.from({ length: 256 }, (_, i) => {
    const x = i / 255, angle = (hue(x) * Math.PI) / 180;
    return fromOklab(light(x), chroma(x) * Math.cos(angle), chroma(x) * Math.sin(angle));
  });
}

// More is lighter, evenly: blue violet over green to yellow.
const SEQUENTIAL = table((x) => 0.2 + 0.72 * x, (x) => 0.09 + 0.06 * x, (x) => 290 - 190 * x);

// Zero is dark; both signs grow lighter alike, blue below and orange above.
const DIVERGING = table(
  (x) => 0.24 + 0.62 * Math.abs(2 * x - 1),
  (x) => 0.16 * Math.sqrt(Math.abs(2 * x - 1)) * (1.25 - 0.45 * Math.abs(2 * x - 1)),
  (x) => (x < 0.5 ? 245 : 60),
);

const GRAYS = table((x) => 0.12 + 0.86 * x, () => 0, () => 0);

// Colours that stand for no number.
const CATEGORIES = {
  miss: { color: [38, 42, 49], words: "miss" },
  nan: { color: [255, 0, 255], words: "NaN, not a number" },
  inf: { color: [0, 235, 255], words: "+infinity" },
  neginf: { color: [120, 255, 60], words: "\u2212infinity" },
  oneSide: { color: [255, 225, 90], words: "hit on one side only" },
  noShare: { color: [128, 134, 142], words: "hit on one side only" }, // among shares, where yellow is a number
  beyond: { color: [255, 70, 60], words: "beyond the bound" },
  unbounded: { color: [255, 170, 200], words: "no bound holds (infinite)" },
};

/** The colour of an id: always the same, and far from those of its neighbours. */
function idColor(number) {
  const light = 0.55 + 0.3 * ((number * 0.381966) % 1);
  const angle = 2 * Math.PI * ((number * 0.618034 + 0.13) % 1);
  return fromOklab(light, 0.12 * Math.cos(angle), 0.12 * Math.sin(angle));
}

function css(color) {
  return `rgb(${color[0]},${color[1]},${color[2]})`;
}

function gradient(colors) {
  return `linear-gradient(to right, ${colors.filter((_, i) => i % 15 === 0).map(css).join(",")})`;
}

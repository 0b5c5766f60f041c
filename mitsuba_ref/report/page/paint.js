// Layers as colours. Each painter gives an RGBA image and the legend of its colours.

const PICTURES = {
  ours: { words: JUDGED, paint: (record, data) => paintSide(record, data, "ours", 1) },
  reference: { words: "reference", paint: (record, data) => paintSide(record, data, "reference", 2) },
  difference: { words: `${JUDGED} \u2212 reference`, paint: paintDifference },
  ratio: { words: "difference over bound", paint: paintRatio },
  class: { words: "class", paint: paintClasses },
};

/** An image that is filled pixel by pixel, and the categories that occurred. */
class Canvas {
  constructor(record) {
    this.record = record;
    this.image = new ImageData(record.width, record.height);
    this.counts = {};
  }

  put(i, color) {
    const pixels = this.image.data, at = 4 * i;
    pixels[at] = color[0];
    pixels[at + 1] = color[1];
    pixels[at + 2] = color[2];
    pixels[at + 3] = 255;
  }

  category(i, name) {
    this.counts[name] = (this.counts[name] ?? 0) + 1;
    this.put(i, CATEGORIES[name].color);
  }

  swatches() {
    return Object.entries(this.counts).map(([name, count]) => ({ ...CATEGORIES[name], count }));
  }
}

const oddity = (value) => (Number.isNaN(value) ? "nan" : value > 0 ? "inf" : "neginf");
const mapped = (colors, share) => colors[Math.round(255 * Math.min(1, Math.max(0, share)))];

function paintSide(record, data, side, bit) {
  if (!data[side]) return null;
  const canvas = new Canvas(record), numbers = data[side];
  const colorOf = sideColors(data, numbers);
  for (let i = 0; i < data.count; i++) {
    const odd = isFloat(data.layer) ? oddest(data, numbers, i) : NaN;
    if (!(record.hits[i] & bit)) canvas.category(i, "miss");
    else if (isFloat(data.layer) && !Number.isFinite(odd)) canvas.category(i, oddity(odd));
    else canvas.put(i, colorOf(i));
  }
  return { image: canvas.image, legend: { ...sideLegend(data), swatches: canvas.swatches() } };
}

/** The first value that is not finite, if there is one. */
function oddest(data, numbers, i) {
  for (let c = 0; c < data.channels; c++) {
    const value = numbers[c * data.count + i];
    if (!Number.isFinite(value)) return value;
  }
  return 0;
}

function sideColors(data, numbers) {
  const { count, layer, range } = data, gain = 2 ** state.e;
  const three = (f) => (i) => [0, 1, 2].map((c) => 255 * Math.min(1, Math.max(0, f(numbers[c * count + i], c))));
  if (layer.kind === "scalar") return (i) => mapped(GRAYS, 1 - ((numbers[i] - range.low) / range.span) * gain * 0.85);
  if (layer.kind === "vector") return three((v) => 0.5 + 0.5 * v);
  if (layer.kind === "place") return three((v, c) => ((v - range.each[c].low) / range.each[c].span) * gain);
  if (layer.kind === "uv")
    return (i) => [0, 1].map((c) => 255 * fraction(numbers[c * count + i])).concat(0);
  if (layer.kind === "light") return three((v) => ((v / (range.bright || 1)) * gain) ** (1 / 2.2));
  if (layer.kind === "mask") return (i) => mapped(GRAYS, numbers[i]);
  return (i) => idColor(numbers[i]);
}

/** 1 for the last of a range, whose next begins at 0. */
const fraction = (value) => (value === 1 ? 1 : value - Math.floor(value));

function sideLegend(data) {
  const { layer, range } = data, gain = 2 ** state.e;
  if (layer.kind === "scalar") {
    const far = range.low + range.span / (0.85 * gain);
    const [from, to] = ends(range.low, far);
    return { colors: [...GRAYS].reverse(), ticks: [[0, from], [1, to]], words: "near is light" };
  }
  if (layer.kind === "vector") return { words: "x, y, z from \u22121 to 1 as red, green, blue" };
  if (layer.kind === "place") {
    const [x, y, z] = range.each.map(({ low, span }) => ends(low, low + span / gain).join(" to "));
    return { words: `red x ${x}, green y ${y}, blue z ${z}` };
  }
  if (layer.kind === "uv") return { words: "fractions of u and v as red and green" };
  if (layer.kind === "light") return { words: `radiance up to ${brief(range.bright / gain)}, gamma 2.2` };
  if (layer.kind === "mask") return { words: "white: hit" };
  return { words: "one colour per number" };
}

function paintDifference(record, data) {
  if (!data.ours) return null;
  const canvas = new Canvas(record), most = isFloat(data.layer) ? data.range.difference / 2 ** state.e : 1;
  for (let i = 0; i < data.count; i++) {
    const sides = record.hits[i];
    if (sides === 0) canvas.category(i, "miss");
    else if (sides !== 3) canvas.category(i, "oneSide");
    else {
      const d = largestDifference(data, i);
      if (!Number.isFinite(d)) canvas.category(i, oddity(d));
      else canvas.put(i, mapped(DIVERGING, 0.5 + (0.5 * (isFloat(data.layer) ? d : Math.sign(d))) / most));
    }
  }
  const ticks = [[0, `\u2212${brief(most)}`], [0.5, "0"], [1, brief(most)]];
  const words = data.channels > 1 ? "the channel that differs most" : "";
  const plain = { words: "dark: the same number on both sides" };
  const legend = isFloat(data.layer) ? { colors: DIVERGING, ticks, words } : plain;
  return { image: canvas.image, legend: { ...legend, swatches: canvas.swatches() } };
}

const OCTAVES = 12; // of the logarithmic scale of shares: from 1/4096 of the bound to all of it

function paintRatio(record, data) {
  if (!data.ratio) return null;
  const canvas = new Canvas(record), { ratio } = data;
  for (let i = 0; i < data.count; i++) {
    if (ratio[i] === Infinity) canvas.category(i, "unbounded");
    else if (ratio[i] > 1) canvas.category(i, "beyond");
    else if (record.hits[i] === 0) canvas.category(i, "miss");
    else if (record.hits[i] !== 3 && isFloat(data.layer)) canvas.category(i, "noShare");
    else canvas.put(i, mapped(SEQUENTIAL, 1 + Math.log2(ratio[i]) / OCTAVES));
  }
  const ticks = [0.001, 0.01, 0.1, 1].map((share) => [1 + Math.log2(share) / OCTAVES, String(share)]);
  const words = data.layer.name === "all" ? "share of its bound that the worst check uses" : "share of the bound";
  return { image: canvas.image, legend: { colors: SEQUENTIAL, ticks, words, swatches: canvas.swatches() } };
}

/** Pixels that agree are light where ours is light, for orientation. */
function paintClasses(record, data) {
  const canvas = new Canvas(record), counts = RUN.classes.map(() => 0);
  const colors = RUN.classes.map((name) => CLASS_COLORS[name]);
  const shown = data.ours ? sideColors(data, data.ours) : () => [128, 128, 128];
  const shaded = (i) => {
    const [r, g, b] = shown(i), light = 0.55 + (0.6 * (0.3 * r + 0.59 * g + 0.11 * b)) / 255;
    return colors[0].map((c) => c * (Number.isFinite(light) ? light : 1));
  };
  for (let i = 0; i < record.classes.length; i++) {
    const code = record.classes[i];
    if (code === 0 && record.hits[i] === 0) canvas.category(i, "miss");
    else canvas.put(i, code === 0 ? shaded(i) : colors[code]), (counts[code] += 1);
  }
  const used = RUN.classes.map((name, code) => ({ color: colors[code], words: className(name), count: counts[code] }))
    .filter((swatch) => swatch.count);
  return { image: canvas.image, legend: { swatches: [...used, ...canvas.swatches()] } };
}

const spaced = (name) => name.replaceAll("_", " ");
const CLASS_NAMES = { unlisted: "reference wrong, unlisted", wrong: `${JUDGED} wrong` };
const className = (name) => CLASS_NAMES[name] ?? spaced(name);

// Layers as colours. Each painter gives an RGBA image and the legend of its colours.

const PICTURES = {
  ours: { words: JUDGED, paint: (record, data) => paintSide(record, data, "ours", 1) },
  reference: { words: REFERENCE, paint: (record, data) => paintSide(record, data, "reference", 2) },
  difference: { words: `${JUDGED} \u2212 ${REFERENCE}`, paint: paintDifference },
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

/** The ends of a channel's colours: as chosen, else those of most values. */
function levelsOf(data, c) {
  const { low, span } = data.range.each[c], chosen = (text, usual) => (text === "" ? usual : Number(text));
  const from = chosen(state.lo, low), to = chosen(state.hi, low + span);
  return { from, to, scale: 2 ** state.e / (to - from || Number.MIN_VALUE) };
}

function sideColors(data, numbers) {
  const { count, layer } = data;
  if (layer.kind === "uv" || layer.kind === "two")
    return (i) => [0, 1].map((c) => 255 * fraction(numbers[c * count + i])).concat(0);
  if (layer.kind === "mask") return (i) => mapped(GRAYS, numbers[i]);
  if (layer.kind === "id") return (i) => idColor(numbers[i]);
  const levels = data.range.each.map((_, c) => levelsOf(data, c));
  const share = (i, c) => (numbers[c * count + i] - levels[c].from) * levels[c].scale + state.of;
  if (layer.kind === "scalar") return (i) => mapped(GRAYS, 1 - 0.85 * share(i, 0));
  if (layer.kind === "value") return (i) => mapped(GRAYS, share(i, 0));
  const power = layer.kind === "light" || layer.kind === "four" ? 1 / 2.2 : 1;
  return (i) => [0, 1, 2].map((c) => 255 * Math.min(1, Math.max(0, share(i, c))) ** power);
}

/** 1 for the last of a range, whose next begins at 0. */
const fraction = (value) => (value === 1 ? 1 : value - Math.floor(value));

function sideLegend(data) {
  const { layer } = data;
  if (layer.kind === "mask") return { words: "white: hit" };
  if (layer.kind === "id") return { words: "one colour per number" };
  if (layer.kind === "uv" || layer.kind === "two") return { words: "fractions of both numbers as red and green" };
  const shown = data.range.each.map((_, c) => { // the values that are drawn with no light, and with all of it
    const { from, scale } = levelsOf(data, c);
    return ends(from - state.of / scale, from + (1 - state.of) / scale);
  });
  if (layer.kind === "scalar" || layer.kind === "value") {
    const colors = layer.kind === "scalar" ? [...GRAYS].reverse() : GRAYS;
    return { colors, ticks: [[0, shown[0][0]], [1, shown[0][1]]], words: layer.kind === "scalar" ? "near is light" : "" };
  }
  const names = ["red", "green", "blue"].map((color, c) => `${color} ${CHANNELS[layer.kind][c]} ${shown[c].join(" to ")}`);
  if (layer.kind === "place") return { words: names.join(", ") };
  if (layer.kind === "vector") return { words: `x, y, z from ${shown[0].join(" to ")} as red, green, blue` };
  return { words: `from ${shown[0].join(" to ")}, gamma 2.2` };
}

function paintDifference(record, data) {
  if (!data.ours) return null;
  const canvas = new Canvas(record), most = isFloat(data.layer) ? data.range.difference / 2 ** state.e : 1;
  for (let i = 0; i < data.count; i++) {
    const sides = record.hits[i];
    if (sides === 0) canvas.category(i, "miss");
    else if (sides !== 3) canvas.category(i, "oneSide");
    else {
      const finite = !isFloat(data.layer) || [data.ours, data.reference].every((side) => Number.isFinite(oddest(data, side, i)));
      const d = finite ? data.difference?.[i] ?? Math.sign(data.ours[i] - data.reference[i]) : largestDifference(data, i);
      if (!Number.isFinite(d)) canvas.category(i, oddity(d));
      else canvas.put(i, mapped(DIVERGING, 0.5 + (0.5 * d) / most));
    }
  }
  const ticks = [[0, `\u2212${brief(most)}`], [0.5, "0"], [1, brief(most)]];
  const words = data.channels > 1 ? "the channel that differs most" : "";
  const plain = { words: "dark: the same number on both sides" };
  const legend = isFloat(data.layer) ? { colors: DIVERGING, ticks, words } : plain;
  return { image: canvas.image, legend: { ...legend, swatches: canvas.swatches() } };
}

const NOTABLE = 0.1; // of a bound: below, a share is grey, since rounding uses that much everywhere

/** Shares from 0 to 1 over the first tenth of the scale in greys, then by their logarithm in colours. */
const ratioPlace = (share) => (share < NOTABLE ? share / 0.8 : 0.125 + 0.875 * (1 + Math.log10(share)));
const RATIOS = Array.from({ length: 256 }, (_, i) => (i < 32 ? GRAYS[40 + 2 * i] : SEQUENTIAL[Math.round(255 * (i - 32) / 223)]));

function paintRatio(record, data) {
  if (!data.ratio) return null;
  const canvas = new Canvas(record), { ratio } = data;
  for (let i = 0; i < data.count; i++) {
    if (ratio[i] === Infinity) canvas.category(i, "unbounded");
    else if (ratio[i] > 1) canvas.category(i, "beyond");
    else if (record.hits[i] === 0) canvas.category(i, "miss");
    else if (record.hits[i] !== 3 && isFloat(data.layer)) canvas.category(i, "noShare");
    else canvas.put(i, mapped(RATIOS, ratioPlace(ratio[i])));
  }
  const ticks = [0, 0.1, 0.2, 0.5, 1].map((share) => [ratioPlace(share), String(share)]);
  const words = data.layer.name === "all" ? "the worst check\u2019s share of its bound" : "share of the bound; grey: under a tenth";
  return { image: canvas.image, legend: { colors: RATIOS, ticks, words, swatches: canvas.swatches() } };
}

/** Pixels that agree are light where ours is light, for orientation. */
function paintClasses(record, data) {
  if (COMPARED) return null;
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

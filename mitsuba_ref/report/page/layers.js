// Layers: the compared quantities, where their numbers are, and which check judges them.

const LAYERS = [
  { name: "depth", key: "1", kind: "scalar", check: "depth", words: "depth" },
  { name: "normal", key: "2", kind: "vector", check: "normal", words: "normal" },
  { name: "shading_normal", key: "3", kind: "vector", check: "shading_normal", words: "shading normal" },
  { name: "position", key: "4", kind: "place", check: "position", words: "position" },
  { name: "uv", key: "5", kind: "uv", check: "uv", words: "uv" },
  { name: "diffuse", key: "6", kind: "light", check: "diffuse", words: "diffuse" },
  { name: "shape_id", key: "7", kind: "id", check: "shape_id", words: "shape" },
  { name: "prim_id", key: "8", kind: "id", check: "", words: "primitive" },
  { name: "hit", key: "9", kind: "mask", check: "mask", words: "hit" },
  { name: "all", key: "a", kind: "none", check: "", words: "all checks" },
];
const CHANNELS = { scalar: [""], vector: ["x", "y", "z"], place: ["x", "y", "z"], light: ["r", "g", "b"], uv: ["u", "v"] };

const OTHER_CHECKS = { mask: "hit" }; // check -> layer, where their names differ

/** The layer of the check that fails at the pixel of the address, or else of the worst pixel of the scene. */
function layerToStart(record) {
  const { failures } = record.verdict;
  const failure = failures.find((each) => each.x === state.x && each.y === state.y) ?? failures[0];
  const check = failure?.check ?? "";
  return LAYERS.find((layer) => layer.name === (OTHER_CHECKS[check] ?? check))?.name ?? "depth";
}

const layerNamed = (name) => LAYERS.find((layer) => layer.name === name) ?? LAYERS[0];
const isFloat = (layer) => layer.kind in CHANNELS;

function isThere(record, layer) {
  if (layer.name === "hit") return true;
  if (layer.kind === "id") return record.has("ids");
  return record.has(layer.name === "all" ? "ratio" : layer.name);
}

/** A message for a layer that the candidate does not give; "" for others. */
function notGiven(record, layer) {
  const unjudged = record.verdict.unjudged ?? [];
  return RUN.candidate && (unjudged.includes(layer.name) || layer.name === "prim_id")
    ? `the candidate gives no ${layer.words}: not judged` : "";
}

/** {ours, reference, channels, ratio, bound, alone, own}: arrays, channel by channel; null if missing. */
async function layerData(record, layer) {
  const count = record.classes.length;
  const data = { layer, count, channels: 1, missing: notGiven(record, layer) };
  for (const name of ["ours", "reference", "ratio", "bound", "alone", "own"]) data[name] = null;
  if (data.missing && layer.kind !== "id") return data;
  if (!isThere(record, layer)) {
    data.missing = `${layer.words}: not stored`;
  } else if (isFloat(layer)) {
    data.channels = CHANNELS[layer.kind].length;
    data.reference = await record.array(layer.name, "reference");
    data.ours = await record.array(layer.name, "ours", "reference");
    const part = record.part(layer.name);
    if (part.ratio) data.ratio = await record.array(layer.name, "ratio");
    if (part.bound) data.bound = await record.array(layer.name, "bound");
    if (part.alone) data.alone = await record.array(layer.name, "alone");
    if (part.own) data.own = await record.array(layer.name, "own");
  } else if (layer.name === "all") {
    data.ratio = await record.array("ratio", "ratio");
  } else if (layer.name === "hit") {
    data.ours = record.hits.map((bits) => bits & 1);
    data.reference = record.hits.map((bits) => bits >> 1);
  } else {
    const which = layer.name === "shape_id" ? "shape" : "prim";
    data.ours = record[`${which}_ours`] ?? null;
    data.reference = record[`${which}_reference`];
  }
  if (!data.ratio && layer.check && record.about.shares?.[layer.check])
    data.ratio = await record.array("about/shares", layer.check);
  if (isFloat(layer) && data.ours) data.range = rangesOf(record, data);
  return data;
}

/** The range of a colour map: quantiles of the finite values where the reference hits. */
function rangesOf(record, data) {
  const shown = Array.from({ length: data.channels }, () => []), apart = [], sizes = [];
  for (let i = 0; i < data.count; i++) {
    if (!(record.hits[i] & 2)) continue;
    for (let c = 0; c < data.channels; c++) {
      const at = c * data.count + i, value = data.reference[at], d = data.ours[at] - value;
      if (Number.isFinite(value)) shown[c].push(value), sizes.push(Math.abs(value));
      if (record.hits[i] === 3 && Number.isFinite(d)) apart.push(Math.abs(d));
    }
  }
  const difference = quantile(apart, 0.99) || quantile(apart, 1) || quantile(sizes, 0.5) * 2 ** -24 || 1;
  const each = shown.map((numbers) => spread(quantile(numbers, 0.01), quantile(numbers, 0.97)));
  return { ...each[0], each, bright: quantile(sizes, 0.98), difference };
}

function spread(low, high) {
  return { low, span: high - low || Math.abs(high) || 1 };
}

function quantile(numbers, share) {
  if (!numbers.length) return 0;
  const every = Math.max(1, Math.floor(numbers.length / 20000)); // enough for a colour
  const some = every > 1 && share < 1 ? numbers.filter((_, i) => i % every === 0) : numbers;
  return Float64Array.from(some).sort()[Math.round(share * (some.length - 1))];
}

/** The signed difference of the channel that differs most; NaN if any is NaN. */
function largestDifference(data, i) {
  let largest = 0;
  for (let c = 0; c < data.channels; c++) {
    const at = c * data.count + i, d = data.ours[at] - data.reference[at];
    const same = data.ours[at] === data.reference[at]; // two infinities, too
    if (Number.isNaN(d) && !same) return NaN;
    if (!same && !(Math.abs(d) <= Math.abs(largest))) largest = d;
  }
  return largest;
}

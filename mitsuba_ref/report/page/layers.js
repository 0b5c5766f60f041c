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
const CHANNELS = {
  scalar: [""], value: [""], vector: ["x", "y", "z"], place: ["x", "y", "z"], light: ["r", "g", "b"], uv: ["u", "v"],
  two: ["1", "2"], four: ["r", "g", "b", "a"],
};
const KIND_OF_CHANNELS = { 1: "value", 2: "two", 3: "light", 4: "four" };
const OTHER_CHECKS = { mask: "hit" }; // check -> layer, where their names differ

/** The layers of a record: of two images without a judge, those that both have. */
function layersOf(record) {
  if (!COMPARED) return LAYERS;
  return Object.entries(record.about.layers).map(([name, channels], i) => {
    const known = LAYERS.find((layer) => layer.name === name && isFloat(layer) && CHANNELS[layer.kind].length === channels);
    return { name, key: i < 9 ? String(i + 1) : "", check: "", kind: known?.kind ?? KIND_OF_CHANNELS[channels], words: known?.words ?? name };
  });
}

/** The layer of the check that fails at the pixel of the address, or else of the worst pixel of the scene. */
function layerToStart(record) {
  const failures = record.verdict?.failures ?? [];
  const failure = failures.find((each) => each.x === state.x && each.y === state.y) ?? failures[0];
  return layerOfCheck(record, failure?.check)?.name ?? (record.layers.find((layer) => layer.name !== "hit") ?? record.layers[0]).name;
}

const layerOfCheck = (record, check) => record.layers.find((layer) => layer.name === (OTHER_CHECKS[check] ?? check));
const layerNamed = (name) => looking.record.layers.find((layer) => layer.name === name) ?? looking.record.layers[0];
const isFloat = (layer) => layer.kind in CHANNELS;

function isThere(record, layer) {
  if (layer.name === "hit" || layer.name === "all") return true;
  return record.has(layer.kind === "id" ? "ids" : layer.name);
}

/** A message for a layer that the candidate does not give; "" for others. */
function notGiven(record, layer) {
  const unjudged = record.verdict?.unjudged ?? [];
  return RUN.candidate && (unjudged.includes(layer.name) || layer.name === "prim_id")
    ? `the candidate gives no ${layer.words}: not judged` : "";
}

/** {ours, reference, difference, ratio, channels}: arrays, channel by channel; null if missing. exact: what is known of
 *  the rows that are stored without loss. */
async function layerData(record, layer) {
  const count = record.classes.length;
  const data = { layer, count, channels: 1, missing: notGiven(record, layer), exact: {} };
  for (const name of ["ours", "reference", "difference", "ratio"]) data[name] = null;
  if (data.missing && layer.kind !== "id") return data;
  if (!isThere(record, layer)) {
    data.missing = `${layer.words}: not stored`;
  } else if (isFloat(layer)) {
    data.channels = CHANNELS[layer.kind].length;
    await (COMPARED ? wholeLayer : roundedLayer)(record, data);
  } else if (layer.name === "all") {
    data.ratio = await worstShares(record);
  } else if (layer.name === "hit") {
    data.ours = record.hits.map((bits) => bits & 1);
    data.reference = record.hits.map((bits) => bits >> 1);
  } else {
    const which = layer.name === "shape_id" ? "shape" : "prim";
    data.ours = record[`${which}_ours`] ?? null;
    data.reference = record[`${which}_reference`];
  }
  if (!data.ratio && layer.check && record.about.shares?.[layer.check])
    data.ratio = sharesOf(await record.array("about/shares", layer.check), RUN.codes);
  if (isFloat(layer) && data.ours) data.range = rangesOf(record, data);
  return data;
}

/** A layer of two images, stored without loss. */
async function wholeLayer(record, data) {
  const { name } = data.layer;
  data.reference = await record.array(name, "reference");
  data.ours = await record.array(name, "ours");
  if (record.part(name).ratio) data.ratio = await record.array(name, "ratio");
  data.difference = new Float64Array(data.count);
  for (let i = 0; i < data.count; i++) data.difference[i] = largestDifference(data, i);
}

/** A layer of a judged scene: rounded, but for some rows. */
async function roundedLayer(record, data) {
  const name = record.part(data.layer.name).same ?? data.layer.name, part = record.part(name), { count } = data;
  const codes = await record.array(name, "reference"), apart = await record.array(name, "ours");
  data.steps = part.steps;
  data.reference = valuesOf(codes, part.steps, RUN.codes);
  data.ours = valuesOf(codes.map((code, i) => code + apart[i]), part.steps, RUN.codes);
  data.difference = errorsOf(await record.array(name, "difference"), part.unit);
  data.ratio = sharesOf(await record.array(name, "ratio"), RUN.codes);
  for (const each of Object.keys(part.exact)) data.exact[each] = await record.array(`${name}/exact`, each);
  const { exact } = data, among = record.withoutLoss.size;
  for (const [row, i] of record.withoutLoss) {
    for (let c = 0; c < data.channels; c++)
      for (const side of ["ours", "reference"]) data[side][c * count + row] = exact[side][c * among + i];
    if (record.hits[row] === 3) data.difference[row] = largestDifference(data, row);
    data.ratio[row] = exact.ratio[i];
  }
}

/** The largest share of any check at each pixel. */
async function worstShares(record) {
  const worst = new Float64Array(record.classes.length);
  const add = (shares) => shares.forEach((share, i) => { if (share > worst[i]) worst[i] = share; });
  for (const layer of record.layers.filter((each) => isFloat(each) && isThere(record, each) && !notGiven(record, each)))
    add((await inspectedLayer(record, layer)).ratio);
  for (const name of Object.keys(record.about.shares)) add(sharesOf(await record.array("about/shares", name), RUN.codes));
  return worst;
}

/** The range of a colour map: quantiles of the finite values where the reference hits. */
function rangesOf(record, data) {
  const shown = Array.from({ length: data.channels }, () => []), apart = [], sizes = [];
  for (let i = 0; i < data.count; i++) {
    if (!(record.hits[i] & 2)) continue;
    for (let c = 0; c < data.channels; c++) {
      const value = data.reference[c * data.count + i];
      if (Number.isFinite(value)) shown[c].push(value), sizes.push(Math.abs(value));
    }
    if (record.hits[i] === 3 && Number.isFinite(data.difference[i])) apart.push(Math.abs(data.difference[i]));
  }
  const difference = quantile(apart, 0.99) || quantile(apart, 1) || quantile(sizes, 0.5) * 2 ** -24 || 1;
  const each = shown.map((numbers) => spread(quantile(numbers, 0.01), quantile(numbers, 0.97)));
  if (data.layer.kind === "vector") each.fill({ low: -1, span: 2 });
  if (data.layer.kind === "light" || data.layer.kind === "four") each.fill(spread(0, quantile(sizes, 0.98)));
  return { each, difference };
}

function spread(low, high) {
  return high > low ? { low, span: high - low } : { low: Math.min(0, low), span: Math.abs(low) || 1 };
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

/** The layer in which a pixel differs most, over its bounds: the chosen one if it is beyond its own. */
function differingLayer(record, row) {
  const listed = (record.verdict?.failures ?? []).find(({ x, y }) => record.row(x, y) === row);
  const share = (layer) => (layer.check === listed?.check ? Infinity : shareAt(record, layer, row));
  if (shareAt(record, layerNamed(state.a), row) > 1) return state.a;
  const judged = record.layers.filter((layer) => layer.check);
  const worst = judged.reduce((best, layer) => (share(layer) > share(best) ? layer : best), judged[0]);
  return worst && share(worst) > 1 ? worst.name : state.a;
}

function shareAt(record, layer, row) {
  return inspected.get(layer.name)?.ratio?.[row] ?? inspected.get(`share ${layer.check}`)?.[row] ?? 0;
}

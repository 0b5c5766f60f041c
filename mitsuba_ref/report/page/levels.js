// Which values are drawn dark and light: exposure, offset, both ends, and a histogram of the values.

const BINS = 96;

function expose(step) {
  change({ e: step === 0 ? 0 : Math.min(40, Math.max(-40, state.e + step)), ...(step === 0 ? { of: 0, lo: "", hi: "" } : {}) });
  showLayer(++turn);
}

/** A field of the levels: its text is a number, or empty for the usual one. */
function setLevel(key, text) {
  if (text.trim() !== "" && !Number.isFinite(Number(text))) return showStatus(`expected a number, got ${text}`);
  change({ [key]: key === "of" ? Number(text) : text.trim() });
  showLayer(++turn);
}

const HAS_LEVELS = new Set(["scalar", "value", "vector", "place", "light", "four"]);

/** Fill the fields and the histogram for this layer. */
function showLevels(record, data) {
  const there = HAS_LEVELS.has(data.layer.kind) && Boolean(data.range);
  byId("gain").textContent = `${state.e > 0 ? "+" : ""}${state.e}`;
  for (const each of byId("levels").querySelectorAll("input")) each.disabled = !there;
  byId("offset").value = state.of || "";
  for (const [id, key] of [["low", "lo"], ["high", "hi"]]) byId(id).value = state[key];
  if (there) {
    const { low, span } = data.range.each[0];
    [byId("low").placeholder, byId("high").placeholder] = ends(low, low + span).map(String);
  }
  drawHistogram(record, data, there);
}

/** Values of both sides over the range of most of them: the reference filled, ours as a line. */
function drawHistogram(record, data, there) {
  const canvas = byId("histogram"), context = canvas.getContext("2d"), { width, height } = canvas;
  context.clearRect(0, 0, width, height);
  if (!there) return;
  const low = Math.min(...data.range.each.map((each) => each.low)), high = Math.max(...data.range.each.map((each) => each.low + each.span));
  const from = low - 0.1 * (high - low), step = (1.2 * (high - low)) / BINS;
  const counts = (numbers, bit) => {
    const bins = new Float64Array(BINS);
    for (let i = 0; i < data.count; i++) if (record.hits[i] & bit) for (let c = 0; c < data.channels; c++) {
      const at = Math.floor((numbers[c * data.count + i] - from) / step);
      if (at >= 0 && at < BINS) bins[at]++;
    }
    return bins;
  };
  const [ours, reference] = [counts(data.ours, 1), counts(data.reference, 2)];
  const most = Math.sqrt(Math.max(1, ...ours, ...reference)), x = (i) => (i * width) / BINS;
  const y = (count) => height - (Math.sqrt(count) / most) * (height - 2); // roots, so that rare values show
  const style = getComputedStyle(document.documentElement);
  context.fillStyle = style.getPropertyValue("--reference");
  context.globalAlpha = 0.45;
  reference.forEach((count, i) => context.fillRect(x(i), y(count), x(1), height));
  context.globalAlpha = 1;
  context.strokeStyle = style.getPropertyValue("--ours");
  context.beginPath();
  ours.forEach((count, i) => (context.lineTo(x(i), y(count)), context.lineTo(x(i + 1), y(count))));
  context.stroke();
  const { from: dark, scale } = levelsOf(data, 0);
  context.fillStyle = style.getPropertyValue("--text");
  for (const value of [dark - state.of / scale, dark + (1 - state.of) / scale]) context.fillRect(((value - from) / step / BINS) * width - 1, 0, 2, height);
  canvas.setAttribute("aria-label", `histogram of the ${data.layer.words}, from ${brief(from)} to ${brief(from + step * BINS)}`);
}

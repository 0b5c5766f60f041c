// One scene: its head, its images and its summary.

const byId = (id) => document.getElementById(id);
const sceneNow = () => RUN.scenes.find((scene) => scene.name === state.s);

let turn = 0; // the call that started last wins
let shownColors = "", shownView = "";

async function showScene() {
  const scene = sceneNow(), mine = ++turn;
  if (!scene) return showMessage(`There is no scene ${state.s} in this report.`);
  currentName = scene.name;
  fillHead(scene);
  showMessage(looking.record?.scene === scene ? "" : "\u2026");
  try {
    const record = await recordOf(scene);
    if (mine !== turn) return;
    if (looking.record !== record) {
      Object.assign(looking, { record, data: null, under: -1 });
      inspected = new Map();
      shownPixel = shownColors = "";
      byId("layers").innerHTML = record.layers.map((layer) =>
        `<button type="button" data-layer="${layer.name}">${layer.key && `<kbd>${layer.key}</kbd>`}${escaped(layer.words)}</button>`).join("");
      applyCause();
      fillSummary(record);
      shownView = "";
    }
    if (!state.a) state.a = layerToStart(record);
    await showLayer(mine);
  } catch (error) {
    if (mine === turn) showMessage(error.message, scene.failure);
  }
}

/** A message in place of the images. */
function showMessage(words, more = "") {
  byId("stages").hidden = byId("side").hidden = Boolean(words);
  byId("tools").hidden = byId("bad").hidden = Boolean(words);
  byId("message").hidden = !words;
  byId("message").innerHTML = `<p>${escaped(words)}</p>${more ? `<pre>${escaped(more)}</pre>` : ""}`;
  if (words) looking.record = null;
}

async function showLayer(mine) {
  const { record } = looking, layer = layerNamed(state.a);
  const data = await inspectedLayer(record, layer);
  if (mine !== turn) return;
  showMessage("");
  if (COMPARED) markDifferences(record, data);
  const colors = JSON.stringify([record.scene.name, layer.name, state.e, state.of, state.lo, state.hi]);
  if (colors !== shownColors || !looking.data) paintAll(record, data);
  shownColors = colors;
  layOut();
  markTools();
  inspectAll(record, mine);
}

/** Of two images without a judge: pixels beyond a bound fail, if there is one; those that differ most are gone to. */
function markDifferences(record, data) {
  const size = (row) => (Number.isNaN(data.difference[row]) || record.hits[row] === 1 || record.hits[row] === 2 ? Infinity : Math.abs(data.difference[row]));
  const sizes = Array.from(record.classes, (_, row) => size(row)), most = quantile(sizes.filter(Number.isFinite), 0.99);
  const beyond = data.ratio ? rowsOf(data.ratio, (share) => share > 1) : [];
  record.mark(beyond, rowsOf(sizes, (each) => each > 0 && each >= most));
}

function paintAll(record, data) {
  looking.data = data;
  looking.bitmaps = {};
  for (const [name, { paint }] of Object.entries(PICTURES)) {
    const painted = paint(record, data);
    if (!painted) continue;
    const bitmap = document.createElement("canvas");
    [bitmap.width, bitmap.height] = [record.width, record.height];
    bitmap.getContext("2d").putImageData(painted.image, 0, 0);
    looking.bitmaps[name] = { bitmap, legend: painted.legend };
  }
}

/** The data of a layer, unpacked once for each scene. */
async function inspectedLayer(record, layer) {
  const known = inspected;
  if (!known.has(layer.name)) known.set(layer.name, await layerData(record, layer));
  return known.get(layer.name);
}

async function loadShares(record) {
  for (const name of Object.keys(record.about.shares ?? {}))
    inspected.set(`share ${name}`, sharesOf(await record.array("about/shares", name), RUN.codes));
  for (const layer of record.layers.filter((each) => each.check)) await inspectedLayer(record, layer);
}

/** Unpack the other layers for the inspector, one after another. */
async function inspectAll(record, mine) {
  for (const layer of record.layers.filter(isFloat)) {
    await inspectedLayer(record, layer);
    if (mine !== turn) return;
    drawSoon();
  }
  await loadShares(record);
  if (mine !== turn) return;
  shownPixel = ""; // which may have more to show now
  drawSoon();
}

/** The panes of this view. Their legends have one height, so that an image keeps its size and place in every view. */
function layOut() {
  const names = viewsOf(looking.record)[state.v] ?? viewsOf(looking.record).all, box = byId("panes");
  if (shownView !== state.v || !looking.panes.length) {
    looking.panes = names.map((name) => new Pane(name));
    box.replaceChildren(...looking.panes.map((pane) => pane.element), byId("summary"));
    box.className = names.length > 3 ? `grid panes-${names.length}` : names.length > 1 ? "grid few" : "single";
    shownView = state.v;
  }
  byId("wiping").hidden = state.v !== "wipe";
  byId("wipe").value = state.w;
  for (const pane of looking.panes) pane.describe();
  for (const pane of looking.panes) pane.fit();
  drawSoon();
}

function fillHead(scene) {
  byId("scene-name").textContent = scene.name;
  byId("scene-mark").innerHTML = markHtml(scene);
  byId("scene-who").textContent = byId("scene-who").title = RUN.candidate && `candidate ${RUN.candidate}`;
  const at = shownScenes.findIndex((each) => each.name === scene.name);
  byId("scene-place").textContent = at < 0 || COMPARED ? "" : `${at + 1} of ${shownScenes.length}`;
  document.title = `${scene.mark} ${scene.name} \u2013 ray-reference`;
}

function markTools() {
  const { record, data } = looking;
  for (const button of document.querySelectorAll("[data-layer]"))
    button.setAttribute("aria-pressed", button.dataset.layer === layerNamed(state.a).name);
  for (const button of document.querySelectorAll("[data-view]")) {
    button.setAttribute("aria-pressed", button.dataset.view === state.v);
    button.hidden = !(button.dataset.view in viewsOf(record));
  }
  const [words, title] = goalOf(record);
  byId("bad").innerHTML = words ? `${words} <kbd>n</kbd>` : title;
  byId("bad").title = `${title} (n)`;
  byId("bad").disabled = !words;
  byId("bad").classList.toggle("strong", record.failing.length > 0 || failedChecks(record).length > 0);
  showLevels(record, data);
}

/** [words, title] of the button of the key n. */
function goalOf(record) {
  if (!record.failing.length && failedChecks(record).length) return ["evidence", "the evidence of the scene check that fails"];
  if (record.failing.length) return ["next bad group", "next group of failing pixels"];
  return record.unlike.length ? [COMPARED ? "next difference" : "next excused group", "next group of pixels that do not agree"] : ["", "every pixel agrees"];
}

const failedChecks = (record) => (record.verdict?.checks ?? []).filter((check) => !check.ok);

function chooseLayer(name) {
  change({ a: name, lo: "", hi: "" });
  showLayer(++turn);
}

function chooseView(name) {
  change({ v: state.v === name ? "all" : name });
  showLayer(++turn);
}

/** Rows to look at: of the chosen cause, else those that fail, else those that pass without agreeing. */
function badRows(record) {
  const rows = record.failing.length ? record.failing : record.unlike;
  return looking.chosen ? rows.filter((row) => looking.chosen.has(row)) : rows;
}

/** The first pixel of the next group: a connected region of one shape and one cause. */
function nextGroup(step) {
  const { record } = looking;
  if (!record) return;
  if (!record.failing.length && failedChecks(record).length && !looking.chosen) return showEvidence(record);
  const key = `${state.f} ${COMPARED ? state.a : ""}`;
  if (record.groupsKey !== key) Object.assign(record, { groups: groupsOf(record, badRows(record)), groupsKey: key });
  const { groups } = record, pinned = pinnedRow(), worst = record.verdict?.failures[0];
  if (!groups.length) return showStatus("every pixel agrees");
  const at = groups.findIndex((group) => group.includes(pinned));
  const start = worst ? Math.max(0, groups.findIndex((group) => group.includes(record.row(worst.x, worst.y)))) : 0;
  const i = at < 0 ? start : (at + step + groups.length) % groups.length;
  const first = worst && at < 0 ? record.row(worst.x, worst.y) : groups[i][0];
  visit(groups[i].includes(first) ? first : groups[i][0]);
  const shape = record.about.shapes?.[shapeAt(record, groups[i][0])];
  showStatus(`group ${i + 1} of ${groups.length}: ${plural(groups[i].length, "pixel")}${shape ? ` at ${shape}` : ""}`);
}

/** Show only the pixels of one cause; the same cause again shows all. */
function chooseCause(number) {
  change({ f: state.f === number ? -1 : number });
  applyCause();
  fillSummary(looking.record);
  drawSoon();
}

/** The rows that the address selects, and a veil over all others. */
function applyCause() {
  const { record } = looking, finding = record.verdict?.findings?.[state.f];
  Object.assign(looking, { chosen: null, veil: null });
  if (!finding) return;
  looking.chosen = new Set(record.failing.filter((row) => why(record, row).includes(finding.what)));
  const veil = document.createElement("canvas");
  [veil.width, veil.height] = [record.width, record.height];
  const image = new ImageData(record.width, record.height);
  for (let row = 0; row < record.classes.length; row++) image.data[4 * row + 3] = looking.chosen.has(row) ? 0 : 190;
  veil.getContext("2d").putImageData(image, 0, 0);
  looking.veil = veil;
}

/** Go to the next pixel that fails, or, if none does, that passes without agreeing. */
function nextBad(step) {
  const { record } = looking;
  if (!record) return;
  const rows = badRows(record);
  if (!rows.length) return showStatus("every pixel agrees");
  const at = pinnedRow(), worst = record.verdict?.failures[0];
  if (at < 0 && worst && !looking.chosen) return visit(record.row(worst.x, worst.y));
  const later = step > 0 ? rows.findIndex((row) => row > at) : rows.findLastIndex((row) => at < 0 || row < at);
  const i = later >= 0 ? later : step > 0 ? 0 : rows.length - 1;
  visit(rows[i]);
  showStatus(`${i + 1} of ${rows.length} ${record.failing.length ? "failing pixels" : "pixels that pass without agreeing"}`);
}

/** Pin a pixel, and open the layer in which it differs. */
async function visit(row) {
  const { record } = looking;
  pin(row);
  await loadShares(record);
  if (looking.record !== record || pinnedRow() !== row) return;
  const name = differingLayer(record, row);
  if (name !== state.a) chooseLayer(name);
}

function movePixel(dx, dy) {
  const { record } = looking, row = pinnedRow();
  if (!record) return;
  const within = (value, low, size) => Math.min(low + size - 1, Math.max(low, value));
  const [x, y] = row < 0 ? center().map(Math.floor) : [state.x + dx, state.y + dy];
  pin(record.row(within(x, record.x0, record.width), within(y, record.y0, record.height)));
}

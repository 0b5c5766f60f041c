// One scene: its head, its images and its summary.

const byId = (id) => document.getElementById(id);
const sceneNow = () => RUN.scenes.find((scene) => scene.name === state.s);

let turn = 0; // the call that started last wins
let shownScene = "", shownLayer = "", shownView = "", shownGain = 0;

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
      shownPixel = shownLayer = "";
      applyCause();
      fillSummary(record);
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
  const data = await layerData(record, layer);
  if (mine !== turn) return;
  showMessage("");
  const same = shownLayer === layer.name && shownScene === record.scene.name && shownGain === state.e;
  if (!same || !looking.data) paintAll(record, data);
  [shownScene, shownLayer, shownGain] = [record.scene.name, layer.name, state.e];
  layOut();
  markTools();
  inspectAll(record, mine);
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

/** Unpack the other layers for the inspector, one after another. */
async function inspectAll(record, mine) {
  inspected.set(looking.data.layer.name, looking.data);
  for (const layer of LAYERS.filter(isFloat)) {
    if (!inspected.has(layer.name)) inspected.set(layer.name, await layerData(record, layer));
    if (mine !== turn) return;
    drawSoon();
  }
  if (record.has("edges")) record.edges = await record.array("edges", "segments");
  const shares = record.about.shares ?? {};
  for (const name of Object.keys(shares)) inspected.set(`share ${name}`, await record.array("about/shares", name));
  if (mine === turn) drawSoon();
}

/** The panes of this view. */
function layOut() {
  const names = VIEWS[state.v] ?? VIEWS.all, box = byId("panes");
  if (shownView !== state.v || !looking.panes.length) {
    looking.panes = names.map((name) => new Pane(name));
    box.replaceChildren(...looking.panes.map((pane) => pane.element), byId("summary"));
    box.className = state.v === "all" ? "grid" : "single";
    shownView = state.v;
  }
  byId("wiping").hidden = state.v !== "wipe";
  byId("wipe").value = state.w;
  for (const pane of looking.panes) pane.describe();
  box.style.setProperty("--legend", "0px"); // as high as the tallest, so that all images have the same size
  const tallest = Math.max(...looking.panes.map((pane) => pane.legend.scrollHeight));
  box.style.setProperty("--legend", `${tallest + 1}px`);
  for (const pane of looking.panes) pane.fit();
  drawSoon();
}

function fillHead(scene) {
  byId("scene-name").textContent = scene.name;
  byId("scene-mark").innerHTML = markHtml(scene);
  byId("scene-who").textContent = byId("scene-who").title = RUN.candidate && `candidate ${RUN.candidate}`;
  const at = shownScenes.findIndex((each) => each.name === scene.name);
  byId("scene-place").textContent = at < 0 ? "" : `${at + 1} of ${shownScenes.length}`;
  document.title = `${scene.name} \u2013 ray-reference`;
}

function markTools() {
  for (const button of document.querySelectorAll("[data-layer]"))
    button.setAttribute("aria-pressed", button.dataset.layer === layerNamed(state.a).name);
  for (const button of document.querySelectorAll("[data-view]"))
    button.setAttribute("aria-pressed", button.dataset.view === state.v);
  byId("gain").textContent = `${state.e > 0 ? "+" : ""}${state.e}`;
}

function chooseLayer(name) {
  change({ a: name });
  showLayer(++turn);
}

function chooseView(name) {
  change({ v: state.v === name ? "all" : name });
  showLayer(++turn);
}

function expose(step) {
  change({ e: step === 0 ? 0 : Math.min(40, Math.max(-40, state.e + step)) });
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
  const key = String(state.f);
  if (record.groupsKey !== key) Object.assign(record, { groups: groupsOf(record, badRows(record)), groupsKey: key });
  const { groups } = record, pinned = pinnedRow(), worst = record.verdict.failures[0];
  if (!groups.length) return showStatus("every pixel agrees");
  const at = groups.findIndex((group) => group.includes(pinned));
  const start = worst ? Math.max(0, groups.findIndex((group) => group.includes(record.row(worst.x, worst.y)))) : 0;
  const i = at < 0 ? start : (at + step + groups.length) % groups.length;
  const first = worst && at < 0 ? record.row(worst.x, worst.y) : groups[i][0];
  pin(groups[i].includes(first) ? first : groups[i][0]);
  const shape = record.about.shapes[shapeAt(record, groups[i][0])];
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
  const { record } = looking, finding = record.verdict.findings?.[state.f];
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
  const at = pinnedRow(), worst = record.verdict.failures[0];
  if (at < 0 && worst && !looking.chosen) return pin(record.row(worst.x, worst.y));
  const later = step > 0 ? rows.findIndex((row) => row > at) : rows.findLastIndex((row) => at < 0 || row < at);
  const i = later >= 0 ? later : step > 0 ? 0 : rows.length - 1;
  pin(rows[i]);
  showStatus(`${i + 1} of ${rows.length} ${record.failing.length ? "failing pixels" : "pixels that pass without agreeing"}`);
}

function movePixel(dx, dy) {
  const { record } = looking, row = pinnedRow();
  if (!record) return;
  const [x, y] = row < 0 ? center().map(Math.floor) : [state.x + dx, state.y + dy];
  const next = record.row(x, y);
  if (next >= 0) pin(next);
}

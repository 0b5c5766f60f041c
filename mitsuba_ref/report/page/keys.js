// Keyboard shortcuts by character, so that they work on every keyboard layout.

const SCENE_KEYS = {
  g: () => chooseView("all"), o: () => chooseView("ours"), r: () => chooseView("reference"),
  d: () => chooseView("difference"), x: () => chooseView("ratio"), l: () => chooseView("class"),
  w: () => chooseView("wipe"), b: () => chooseView("blink"),
  n: () => nextGroup(1), N: () => nextGroup(-1), ".": () => nextBad(1), ",": () => nextBad(-1), c: copyReplay, v: copyValues,
  "+": () => zoomBy(2), "=": () => zoomBy(2), "-": () => zoomBy(0.5), f: fitAll,
  e: () => expose(0.5), E: () => expose(-0.5), 0: () => expose(0),
  ArrowLeft: () => movePixel(-1, 0), ArrowRight: () => movePixel(1, 0),
  ArrowUp: () => movePixel(0, -1), ArrowDown: () => movePixel(0, 1), Home: () => movePixel(-16, 0), End: () => movePixel(16, 0),
  PageUp: () => movePixel(0, -16), PageDown: () => movePixel(0, 16),
  Escape: () => (pinnedRow() >= 0 ? (change({ x: -1, y: -1 }), drawSoon()) : goBack()),
};
const LIST_KEYS = { ArrowUp: () => stepInList(-1), ArrowDown: () => stepInList(1), Escape: () => filterBy({ q: "" }) };
const KEYS_ANYWHERE = {
  "?": toggleHelp, t: toggleTheme, j: () => stepInList(1), k: () => stepInList(-1), "/": startFinding,
};

function onKey(event) {
  if (event.key === "Shift" && !event.repeat) holdShift(true);
  if (event.ctrlKey || event.metaKey || event.altKey || byId("help").open) return;
  const writing = /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName);
  if (writing) return leaveField(event);
  const layer = state.s ? looking.record?.layers.find((each) => each.key === event.key) : null;
  const named = { ...(state.s ? SCENE_KEYS : LIST_KEYS), ...KEYS_ANYWHERE };
  const action = layer ? () => chooseLayer(layer.name) : named[event.key];
  if (!action) return;
  event.preventDefault();
  action();
}

/** In the filter field, Enter and Escape go back to the list. */
function leaveField(event) {
  if (event.key !== "Escape" && event.key !== "Enter") return;
  event.target.blur(); // whose value counts then
  if (event.target.id === "find" && event.key === "Enter" && shownScenes.length) {
    currentName = shownScenes[0].name;
    fillRows();
    focusRow(currentName);
  }
}

/** Back to the list, which a comparison of two images has not. */
function goBack() {
  if (!COMPARED) go({ s: "" });
}

function startFinding() {
  if (COMPARED) return;
  if (state.s) go({ s: "" });
  byId("find").focus();
  byId("find").select();
}

function holdShift(held) {
  if (looking.shift === held) return;
  looking.shift = held;
  if (!state.s || !looking.record || !looking.data) return;
  for (const pane of looking.panes) pane.describe();
  drawSoon();
}

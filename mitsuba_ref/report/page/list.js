// The list of scenes: filtered, sorted, with only the visible rows in the page.

const ROW = 64, ROW_NARROW = 84; // pixels, as in page.css
const SPARE = 6; // rows above and below the visible ones
const SORTS = {
  "": (a, b) => rankOf(a) - rankOf(b) || a.place - b.place,
  name: (a, b) => a.name.localeCompare(b.name),
  failing: (a, b) => b.failing - a.failing || a.place - b.place,
  unlike: (a, b) => unlike(b) - unlike(a) || a.place - b.place,
  worst: (a, b) => shareOf(b) - shareOf(a) || a.place - b.place,
  adjudicated: (a, b) => b.adjudicated - a.adjudicated || a.place - b.place,
  seconds: (a, b) => b.seconds - a.seconds || a.place - b.place,
};
const isWaived = (scene) => scene.mark === "KNOWN" || scene.mark === "SKIP";
const rankOf = (scene) => (scene.mark === "FAIL" ? 0 : isWaived(scene) ? 1 : 2);
const unlike = (scene) => Object.entries(scene.counts).reduce((sum, [name, n]) => sum + (name === "agree" ? 0 : n), 0);
const numberOf = (ratio) => (typeof ratio === "number" ? ratio : ratio === "inf" ? Infinity : NaN);

/** [check, share] of the chosen check, or of the one nearest to its bound. */
function shownShare(scene) {
  return state.ck ? [state.ck, numberOf(scene.ratios[state.ck] ?? 0)] : [scene.worst[0], numberOf(scene.worst[1])];
}
const shareOf = (scene) => shownShare(scene)[1] || 0;

/** The filtered and sorted scenes. */
function listed() {
  const words = state.q.toLowerCase().split(/\s+/).filter(Boolean);
  return RUN.scenes.filter((scene) => {
    const text = `${scene.name} ${scene.path}`.toLowerCase();
    return words.every((word) => text.includes(word)) && hasStatus(scene) && usesCheck(scene) && hasClass(scene);
  }).sort(SORTS[state.o] ?? SORTS[""]);
}

function hasStatus(scene) {
  if (state.st === "pass") return scene.ok;
  if (state.st === "fail") return scene.mark === "FAIL";
  if (state.st === "waived") return isWaived(scene);
  return state.st === "crash" ? scene.crashed : true;
}

/** Whether the scene fails the chosen check, or has any difference in it. */
function usesCheck(scene) {
  return !state.ck || scene.failed_at.includes(state.ck) || numberOf(scene.ratios[state.ck] ?? 0) > 0;
}

function hasClass(scene) {
  if (!state.cl) return true;
  return state.cl === "unlisted" ? scene.unlisted > 0 : scene.counts[state.cl] > 0;
}

const rowsElement = () => document.getElementById("rows");
const rowHeight = () => (matchMedia("(max-width: 700px)").matches ? ROW_NARROW : ROW);
let shownScenes = [];
let currentName = ""; // the row that the keyboard has selected

function showList() {
  shownScenes = listed();
  const [some, all] = [shownScenes.length, RUN.scenes.length];
  document.getElementById("count").textContent = some === all ? plural(all, "scene") : `${some} of ${all} scenes`;
  document.getElementById("nothing").hidden = shownScenes.length > 0;
  document.getElementById("table").setAttribute("aria-rowcount", shownScenes.length + 1);
  for (const button of document.querySelectorAll("[data-sort]")) {
    const chosen = button.dataset.sort === state.o;
    button.closest("[role=columnheader]").setAttribute("aria-sort", chosen ? "descending" : "none");
  }
  fillControls();
  fillRows();
}

function fillControls() {
  for (const [id, key] of [["find", "q"], ["status", "st"], ["check", "ck"], ["class", "cl"], ["order", "o"]]) {
    const element = document.getElementById(id);
    if (element.value !== state[key]) element.value = state[key];
  }
}

/** Only visible rows, and a few more, are in the page. */
function fillRows() {
  const box = rowsElement(), height = rowHeight();
  const first = Math.max(0, Math.floor(box.scrollTop / height) - SPARE);
  const last = Math.min(shownScenes.length, Math.ceil((box.scrollTop + box.clientHeight) / height) + SPARE);
  const inside = document.getElementById("inside");
  const focused = document.activeElement?.dataset?.scene;
  document.getElementById("table").style.setProperty("--gutter", `${box.offsetWidth - box.clientWidth}px`);
  inside.style.height = `${shownScenes.length * height}px`;
  inside.innerHTML = shownScenes.slice(first, last).map((scene, i) => rowHtml(scene, first + i, height)).join("");
  if (focused !== undefined) focusRow(focused);
}

function focusRow(name) {
  document.querySelector(`#inside a[data-scene="${CSS.escape(name)}"]`)?.focus({ preventScroll: true });
}

/** Select the next or previous row of the list. */
function stepInList(step) {
  const at = shownScenes.findIndex((scene) => scene.name === (state.s || currentName));
  const next = shownScenes[Math.min(shownScenes.length - 1, Math.max(0, at + step))];
  if (!next) return;
  currentName = next.name;
  if (state.s) return go({ s: next.name });
  reveal(shownScenes.indexOf(next));
  fillRows();
  focusRow(next.name);
}

function reveal(i) {
  const box = rowsElement(), height = rowHeight();
  if (i * height < box.scrollTop) box.scrollTop = i * height;
  if ((i + 1) * height > box.scrollTop + box.clientHeight) box.scrollTop = (i + 1) * height - box.clientHeight;
}

function filterBy(changes) {
  change(changes);
  rowsElement().scrollTop = 0;
  showList();
}

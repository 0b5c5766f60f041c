// Start-up: filters, buttons, event listeners.

const DARK = matchMedia("(prefers-color-scheme: dark)");

function themeNow() {
  return document.documentElement.dataset.theme || (DARK.matches ? "dark" : "light");
}

function toggleTheme() {
  const theme = themeNow() === "dark" ? "light" : "dark";
  document.documentElement.dataset.theme = theme;
  remember("ray-reference-theme", theme);
  drawSoon();
}

/** Some browsers store nothing for pages from files. */
function remember(key, value) {
  try {
    localStorage.setItem(key, value);
  } catch {
    showStatus("this browser stores no settings for files");
  }
}

function showAll() {
  if (COMPARED) state.s = RUN.scenes[0].name;
  for (const button of document.querySelectorAll("[data-do=back], [data-do=next], [data-do=previous]")) button.hidden = Boolean(COMPARED);
  const inScene = Boolean(state.s);
  byId("list").hidden = inScene;
  byId("scene").hidden = !inScene;
  if (!inScene) {
    turn++;
    looking.record = null;
    document.title = `ray-reference: ${RUN.summary}`;
    showList();
    const at = shownScenes.findIndex((scene) => scene.name === currentName);
    if (at >= 0) reveal(at), fillRows(), focusRow(currentName);
  } else {
    if (!shownScenes.length) shownScenes = listed();
    showScene();
  }
}

function buildTools() {
  const views = {
    all: ["g", "all"], ours: ["o", JUDGED], reference: ["r", REFERENCE], difference: ["d", "difference"],
    ratio: ["x", "over bound"], class: ["l", "class"], wipe: ["w", "wipe"], blink: ["b", "blink"],
  };
  byId("views").innerHTML = Object.entries(views).map(([name, [key, words]]) =>
    `<button type="button" data-view="${name}"><kbd>${key}</kbd>${escaped(words)}</button>`).join("");
}

function buildFilters() {
  const option = (value, words) => `<option value="${value}">${words}</option>`;
  const checks = [...new Set(RUN.scenes.flatMap((scene) => [...Object.keys(scene.ratios), ...scene.failed_at]))];
  byId("check").innerHTML = option("", "any check") + checks.map((name) => option(name, spaced(name))).join("");
  byId("class").innerHTML = option("", "any class") + RUN.classes.map((name) => option(name, className(name))).join("");
}

function fillBanner() {
  byId("total").textContent = RUN.summary;
  byId("who").textContent = byId("who").title = RUN.candidate && `candidate ${RUN.candidate}`;
  byId("wiped").textContent = JUDGED;
  byId("wiped-to").textContent = REFERENCE;
  byId("wipe").setAttribute("aria-label", `wipe between ${JUDGED} and ${REFERENCE}`);
  byId("facts").innerHTML = RUN.facts.map(([term, words]) => `<div><dt>${escaped(term)}</dt><dd>${escaped(words)}</dd></div>`).join("");
  byId("legend").innerHTML = legendOfClasses(RUN.classes.filter((name) => RUN.scenes.some((scene) => countsOf(scene).some(([each, count]) => each === name && count))));
  if (RUN.candidate) byId("status").querySelector("[value=crash]").textContent = "no answer";
  byId("total").className = RUN.scenes.length === RUN.requested && RUN.scenes.every((scene) => scene.ok || isWaived(scene)) ? "good" : "bad";
  const sums = {};
  for (const scene of RUN.scenes) for (const [name, count] of countsOf(scene)) sums[name] = (sums[name] ?? 0) + count;
  byId("sums").textContent = Object.entries(sums).filter(([, count]) => count)
    .map(([name, count]) => `${grouped(count)} ${className(name)}`).join(", ");
  const words = [];
  if (RUN.scenes.length < RUN.requested)
    words.push(`${RUN.scenes.length} of ${RUN.requested} scenes are here: the run has not finished.`);
  byId("common").innerHTML = RUN.common.map((line) => `<p>${escaped(line)}</p>`).join("");
  byId("common").hidden = !RUN.common.length;
  byId("banner").textContent = words.join(" ");
  byId("banner").hidden = !words.length;
}

const DOINGS = {
  back: goBack, next: () => stepInList(1), previous: () => stepInList(-1), help: toggleHelp,
  theme: toggleTheme, copy: copyReplay, values: copyValues, evidence: () => showEvidence(looking.record), bad: () => nextGroup(1), sheet: toggleSheet, in: () => zoomBy(2), out: () => zoomBy(0.5), fit: fitAll,
  brighter: () => expose(0.5), darker: () => expose(-0.5), reset: () => expose(0),
};

/** Fold or unfold the inspector at the foot of a small window. */
function toggleSheet() {
  const open = byId("side").classList.toggle("open");
  document.querySelector("[data-do=sheet]").setAttribute("aria-expanded", open);
}

function onClick(event) {
  const button = event.target.closest("button, a[data-scene], a[data-x], .row");
  if (!button || event.ctrlKey || event.metaKey) return;
  const { dataset } = button;
  const row = button.classList.contains("row") ? button.querySelector("a").dataset.scene : dataset.scene;
  if (row !== undefined) go({ ...CLOSE, s: row });
  else if (dataset.x) pin(looking.record.row(+dataset.x, +dataset.y));
  else if (dataset.cause) chooseCause(+dataset.cause);
  else if (dataset.layer) chooseLayer(dataset.layer);
  else if (dataset.view) chooseView(dataset.view);
  else if (dataset.sort !== undefined) filterBy({ o: state.o === dataset.sort ? "" : dataset.sort });
  else if (dataset.do) DOINGS[dataset.do]();
  else return;
  event.preventDefault();
}

function start() {
  byId("plain").remove();
  buildTools();
  buildFilters();
  fillHelp();
  fillBanner();
  readAddress();
  byId("app").hidden = false;
  document.addEventListener("keydown", onKey);
  document.addEventListener("keyup", (event) => event.key === "Shift" && holdShift(false));
  addEventListener("blur", () => holdShift(false));
  document.addEventListener("click", onClick);
  addEventListener("popstate", () => { readAddress(); showAll(); });
  addEventListener("resize", () => (state.s ? looking.record && looking.data && layOut() : fillRows()));
  rowsElement().addEventListener("scroll", () => requestAnimationFrame(fillRows));
  byId("find").addEventListener("input", (event) => filterBy({ q: event.target.value }));
  for (const [id, key] of [["status", "st"], ["check", "ck"], ["class", "cl"], ["order", "o"]])
    byId(id).addEventListener("change", (event) => filterBy({ [key]: event.target.value }));
  for (const [id, key] of [["offset", "of"], ["low", "lo"], ["high", "hi"]])
    byId(id).addEventListener("change", (event) => setLevel(key, event.target.value));
  byId("wipe").addEventListener("input", (event) => wipeTo(Number(event.target.value)));
  DARK.addEventListener("change", drawSoon);
  setInterval(blink, BLINK_MS);
  showAll();
}

function blink() {
  if (state.v !== "blink" || !looking.record || !looking.data) return;
  looking.phase = 1 - looking.phase;
  for (const pane of looking.panes) pane.describe();
  drawSoon();
}

start();

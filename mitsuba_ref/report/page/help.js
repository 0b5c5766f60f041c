// Keyboard shortcuts, and the dialog that lists them.

const KEYS = [
  ["scenes", [["/", "find"], ["j k", "next, previous scene"], ["Enter", "open"], ["Esc", "back to the list"]]],
  ["layers", [["1 \u2026 9", "depth, normal, shading normal, position, uv, diffuse, shape, primitive, hit"], ["a", "all checks"]]],
  ["views", [
    ["Shift", `hold: ${THE_REFERENCE} in place of ${THE_JUDGED}`], ["g", "all images"],
    ["o", JUDGED], ["r", REFERENCE],
    ["d", "difference"], ["x", "difference over bound"], ["l", "class"], ["w", "wipe"], ["b", "blink"],
  ]],
  ["pixels", [
    ["n N", "next, previous group of bad pixels: one region, shape and cause"], [". ,", "next, previous bad pixel"], ["arrows", "move by one pixel"], ["Home End PageUp PageDown", "move by sixteen pixels"],
    ["c", "copy the command that replays it"], ["v", "copy its values"],
    ["Esc", "unpin the pixel"],
  ]],
  ["image", [
    ["+ \u2212", "zoom; so does the wheel"], ["f", "fit"], ["e E", "exposure up, down"], ["0", "reset exposure, offset, and ends"],
  ]],
  ["page", [["t", "dark or light"], ["?", "this list"]]],
];

function fillHelp() {
  const kbds = (keys) => keys.split(" ").map((key) => `<kbd>${key}</kbd>`).join(" ");
  const entries = (keys) => keys.map(([key, words]) => `<dt>${kbds(key)}</dt><dd>${escaped(words)}</dd>`).join("");
  byId("keys").innerHTML =
    KEYS.map(([title, keys]) => `<section><h3>${title}</h3><dl>${entries(keys)}</dl></section>`).join("");
  byId("terms").innerHTML = COMPARED ? "" : `<h2>Words</h2>${legendOfClasses(RUN.classes)}${termsHtml()}`;
}

function toggleHelp() {
  const window_ = byId("help");
  if (window_.open) window_.close();
  else window_.showModal();
}

let statusTimer = 0;

/** A short message at the foot of the page, for a while. */
function showStatus(words) {
  const box = byId("status-line");
  box.textContent = words;
  box.classList.add("shown");
  clearTimeout(statusTimer);
  statusTimer = setTimeout(() => box.classList.remove("shown"), 2500);
}

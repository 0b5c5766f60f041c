// The keys, and the window that lists them.

const KEYS = [
  ["scenes", [["/", "find"], ["j k", "next, previous scene"], ["Enter", "open"], ["Esc", "back to the list"]]],
  ["layers", [["1 \u2026 9", "depth, normal, shading normal, position, diffuse, shape, primitive, hit, all checks"]]],
  ["views", [
    ["Shift", `hold: the reference in the place of ${THE_JUDGED}`], ["g", "all pictures"],
    ["o", JUDGED], ["r", "reference"],
    ["d", "difference"], ["x", "difference over bound"], ["l", "class"], ["w", "wipe"], ["b", "blink"],
  ]],
  ["pixels", [
    ["n N", "next, previous bad pixel"], ["arrows", "one pixel on"], ["c", "copy the command that shows it again"],
    ["Esc", "let go of the pixel"],
  ]],
  ["picture", [
    ["+ \u2212", "zoom; so does the wheel"], ["f", "fit"], ["e E", "exposure up, down"], ["0", "exposure as it was"],
  ]],
  ["page", [["t", "dark or light"], ["?", "this list"]]],
];

function fillHelp() {
  const kbds = (keys) => keys.split(" ").map((key) => `<kbd>${key}</kbd>`).join(" ");
  const entries = (keys) => keys.map(([key, words]) => `<dt>${kbds(key)}</dt><dd>${words}</dd>`).join("");
  byId("keys").innerHTML =
    KEYS.map(([title, keys]) => `<section><h3>${title}</h3><dl>${entries(keys)}</dl></section>`).join("");
}

function toggleHelp() {
  const window_ = byId("help");
  if (window_.open) window_.close();
  else window_.showModal();
}

let saying = 0;

/** A few words at the foot of the page, for a while. */
function say(words) {
  const box = byId("said");
  box.textContent = words;
  box.classList.add("shown");
  clearTimeout(saying);
  saying = setTimeout(() => box.classList.remove("shown"), 2500);
}

// State of the page, as the part of the address after #: a link shows the same view.

const DEFAULTS = {
  s: "", a: "", v: "all", x: -1, y: -1, z: 0, cx: -1, cy: -1, e: 0, of: 0, lo: "", hi: "", w: 0.5, f: -1, // scene view
  q: "", st: "", ck: "", cl: "", o: "", // list
};
const state = { ...DEFAULTS };

function readAddress() {
  clearTimeout(waiting);
  waiting = 0;
  const given = new URLSearchParams(location.hash.slice(1));
  for (const [key, usual] of Object.entries(DEFAULTS)) {
    const text = given.get(key);
    const number = Number(text);
    state[key] = text === null ? usual : typeof usual === "number" ? (Number.isFinite(number) ? number : usual) : text;
  }
}

function address(changes = {}) {
  const shown = { ...state, ...changes };
  const words = Object.keys(DEFAULTS).filter((key) => shown[key] !== DEFAULTS[key])
    .map((key) => `${key}=${encodeURIComponent(typeof shown[key] === "number" ? +shown[key].toFixed(3) : shown[key])}`);
  return `#${words.join("&")}`;
}

/** Go to another scene or the list, with a step in the history of the browser. */
function go(changes) {
  const place = { z: 0, cx: -1, cy: -1, x: -1, y: -1, f: -1, ...changes };
  const next = address(place);
  if (next === (location.hash || "#")) return;
  writeAddress();
  Object.assign(state, place);
  history.pushState(null, "", next);
  showAll();
}

const REST_MS = 200; // browsers refuse an address that changes hundreds of times while something is dragged
let waiting = 0;

/** Change the view of the same scene; the address follows without a step in the history. */
function change(changes) {
  Object.assign(state, changes);
  if (!waiting) waiting = setTimeout(writeAddress, REST_MS);
}

function writeAddress() {
  if (!waiting) return;
  clearTimeout(waiting);
  waiting = 0;
  history.replaceState(null, "", address());
}

// The list of scenes, which is in the page, and their records, which are loaded when a scene is opened.

const RUN = JSON.parse(document.getElementById("index").textContent);
const CLASS_COLORS = RUN.colors; // class -> [r, g, b]
const KEPT_SCENES = 3; // records that stay in memory
const records = new Map(); // name -> Promise of a SceneRecord
const awaited = new Map(); // name -> function that receives the record from a script of the folder data

RUN.scenes.forEach((scene, i) => { scene.place = i; });

// The subject: our own caster, a candidate in its place, or the first of two images that are compared without a judge.
// In the code, and in addresses, that side is "ours", and the other one "reference".
const COMPARED = RUN.names; // names of two images; undefined for judged scenes
const JUDGED = COMPARED ? COMPARED[0] : RUN.candidate ? "candidate" : "ours";
const THE_JUDGED = !COMPARED && RUN.candidate ? "the candidate" : JUDGED; // in a sentence
const REFERENCE = COMPARED ? COMPARED[1] : "reference";
const THE_REFERENCE = COMPARED ? REFERENCE : "the reference";
const sideName = (side) => ({ ours: JUDGED, reference: REFERENCE })[side] ?? side;

window.ray_reference_scene = (name, parts) => awaited.get(name)?.(parts);

/** Everything about one scene, unpacked on demand. */
class SceneRecord {
  constructor(scene, parts) {
    this.scene = scene;
    this.parts = parts; // name -> object
    this.arrays = new Map();
  }

  has(part) {
    return part in this.parts;
  }

  part(name) {
    return this.parts[name];
  }

  /** One array of a part, unpacked once. */
  array(part, name) {
    const key = `${part}/${name}`;
    if (!this.arrays.has(key)) {
      const from = part.split("/").reduce((place, step) => (place === this ? this.part(step) : place[step]), this);
      this.arrays.set(key, unpacked(from[name]));
    }
    return this.arrays.get(key);
  }

  /** Unpack what every view needs: size of the window, class and hits of each pixel, ids, reasons, exact answers. */
  async begin() {
    const about = (this.about = this.part("about"));
    const [x0, y0, x1, y1] = about.window;
    Object.assign(this, { x0, y0, width: x1 - x0, height: y1 - y0, verdict: about.verdict });
    const count = this.width * this.height;
    this.hits = about.hit ? Uint8Array.from(await this.array("about", "hit")) : new Uint8Array(count).fill(3);
    this.classes = about.class ? Uint8Array.from(await this.array("about", "class")) : new Uint8Array(count);
    this.withoutLoss = about.rows ? new Map(Array.from(await this.array("about", "rows"), (row, i) => [row, i])) : null;
    this.reasons = about.reasons ? await byRow(this, "about/reasons", ["words"]) : new Map();
    this.exact = about.exact ? await byRow(this, "about/exact", ["t", "words"]) : new Map();
    if (this.has("ids")) {
      for (const name of Object.keys(this.part("ids"))) if (name !== "exact") this[name] = await this.array("ids", name);
      if (this.part("ids").exact) {
        this.t_reference = await this.array("ids/exact", "t_reference");
        this.t_ours = await this.array("ids/exact", "t_ours");
      }
    }
    this.layers = layersOf(this);
    this.mark(rowsOf(this.classes, (code) => FAILING.has(RUN.classes[code])), rowsOf(this.classes, (code) => code !== 0));
    return this;
  }

  /** failing, unlike: rows that fail, and that do not agree, which the keys go to and rings show. */
  mark(failing, unlike) {
    Object.assign(this, { failing, unlike, failingMarks: lonely(this, failing), unlikeMarks: lonely(this, unlike), groupsKey: "" });
  }

  /** The place of a row among those that are stored without loss; -1 for others. */
  placeOf(row) {
    return this.withoutLoss ? this.withoutLoss.get(row) ?? -1 : row;
  }

  row(x, y) {
    const inside = x >= this.x0 && y >= this.y0 && x < this.x0 + this.width && y < this.y0 + this.height;
    return inside ? (y - this.y0) * this.width + (x - this.x0) : -1;
  }

  pixel(row) {
    return [this.x0 + (row % this.width), this.y0 + Math.floor(row / this.width)];
  }
}

const FAILING = new Set(["wrong", "undecided", "unlisted"]);

/** Map of row -> its numbers, for a part about some of the pixels. */
async function byRow(record, part, names) {
  const rows = await record.array(part, "rows");
  const columns = await Promise.all(names.map((name) => record.array(part, name)));
  return new Map(Array.from(rows, (row, i) => [row, columns.map((column) => column[i])]));
}

const BLOCK = 6, FEW = 6, MARKS = 200;

/** The first row of each block that, with its neighbours, holds only a few of these rows; more are visible unmarked. */
function lonely(record, rows) {
  const wide = Math.ceil(record.width / BLOCK) + 2; // with a margin, so that neighbours in a row are no wrap
  const blocks = new Map();
  for (const row of rows) {
    const key = Math.floor((row % record.width) / BLOCK) + 1 + wide * Math.floor(row / record.width / BLOCK);
    if (!blocks.has(key)) blocks.set(key, []);
    blocks.get(key).push(row);
  }
  const steps = [-1, 0, 1].flatMap((dy) => [-1, 0, 1].map((dx) => dx + wide * dy));
  const alone = (key) => steps.reduce((sum, step) => sum + (blocks.get(key + step)?.length ?? 0), 0) <= FEW;
  return [...blocks].filter(([key]) => alone(key)).map(([, found]) => found[0]).slice(0, MARKS);
}

function rowsOf(classes, wanted) {
  const rows = [];
  for (let i = 0; i < classes.length; i++) if (wanted(classes[i])) rows.push(i);
  return rows;
}

const SAME_SYMPTOM = " (same symptom, not looked at)"; // mitsuba_ref/judge/diagnosis.py

/** Connected regions of rows with one cause and one shape, the largest first. */
function groupsOf(record, rows) {
  const texts = record.about.reasons?.texts ?? [], left = new Map(), groups = [];
  for (const row of rows) {
    const text = texts[record.reasons.get(row)?.[0]] ?? "";
    left.set(row, [text.replace(SAME_SYMPTOM, ""), shapeAt(record, row)]);
  }
  for (const [first, [cause, shape]] of left) {
    if (!left.delete(first)) continue;
    const group = [first];
    for (const row of group) for (const next of neighbours(record, row)) {
      const [its, of] = left.get(next) ?? [];
      if (of === shape && its === cause) left.delete(next), group.push(next);
    }
    groups.push(group.sort((a, b) => a - b));
  }
  return groups.sort((a, b) => b.length - a.length);
}

/** The number of the shape that the reference hits there, or else ours. */
function shapeAt(record, row) {
  const shape = record.shape_reference?.[row] ?? -1;
  return shape >= 0 ? shape : record.shape_ours?.[row] ?? -1;
}

function neighbours(record, row) {
  const [x, y] = record.pixel(row);
  return [-1, 0, 1].flatMap((dy) => [-1, 0, 1].map((dx) => record.row(x + dx, y + dy)));
}

/** A promise of the record; rejected with a message if there is none. */
function recordOf(scene) {
  if (!records.has(scene.name)) {
    if (records.size >= KEPT_SCENES) records.delete(records.keys().next().value);
    const found = loadedParts(scene).then((parts) => new SceneRecord(scene, parts).begin());
    records.set(scene.name, found);
    found.catch(() => records.delete(scene.name));
  }
  return records.get(scene.name);
}

function loadedParts(scene) {
  if (!scene.file) return Promise.reject(new Error(noPictures(scene)));
  return new Promise((resolve, reject) => {
    const script = document.createElement("script");
    awaited.set(scene.name, resolve);
    script.src = `data/${encodeURIComponent(scene.file)}`;
    script.onload = () => reject(new Error(`data/${scene.file} is not about this scene`)); // later than resolve
    script.onerror = () => reject(new Error(`data/${scene.file} is not there: copy the whole folder`));
    document.head.append(script);
  }).finally(() => awaited.delete(scene.name));
}

function noPictures(scene) {
  const silent = RUN.candidate ? "the candidate gave no answer" : "the reference gave no answer";
  if (scene.crashed) return `There are no images: ${silent}.`;
  return "No images of this scene were stored.";
}

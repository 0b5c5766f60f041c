// Panes: images side by side that zoom and pan together.

const MAX_ZOOM = 128; // screen pixels a pixel
const GRID_FROM = 12, NUMBERS_FROM = 80; // least zoom for lines between pixels, and for numbers in them
const NUMBER_LINES = { 1: [24], 2: [24, 37], 3: [24, 37, 50], 4: [-28, 24, 37, 50] }; // baselines below the middle of a pixel, whose ray is there
const BLINK_MS = 600;

const looking = { record: null, data: null, bitmaps: {}, panes: [], shift: false, phase: 0, under: -1, chosen: null, veil: null };

/** The images of each view; those of shares and classes, which need a judge, only where a record has them. */
function viewsOf(record) {
  const judged = !COMPARED, shares = judged || record.layers.some((layer) => record.part(layer.name)?.ratio);
  const all = ["ours", "reference", "difference", ...(shares ? ["ratio"] : []), ...(judged ? ["class"] : [])];
  return { all, ...Object.fromEntries([...all, "wipe", "blink"].map((name) => [name, [name]])) };
}

/** A figure: caption, canvas, legend. */
class Pane {
  constructor(which) {
    this.which = which;
    this.element = document.createElement("figure");
    this.element.className = `pane ${which}`;
    this.element.innerHTML =
      '<figcaption></figcaption><div class="stage"><canvas></canvas></div><div class="legend"></div>';
    [this.caption, this.stage, this.legend] = this.element.children;
    this.canvas = this.stage.firstChild;
    this.canvas.setAttribute("role", "img");
    this.context = this.canvas.getContext("2d");
    listenTo(this);
  }

  /** Names of the images that are drawn: [left of the wipe, right of it] or one. */
  sources() {
    if (this.which === "wipe") return ["ours", "reference"];
    const turned = this.which === "blink" ? looking.phase === 1 : looking.shift && this.which === "ours";
    return [turned ? "reference" : this.which === "blink" ? "ours" : this.which];
  }

  describe() {
    const [left, right] = this.sources();
    const words = right ? `${PICTURES[left].words} | ${PICTURES[right].words}` : PICTURES[left].words;
    const layer = left === "class" ? "" : looking.data.layer.words;
    const named = (name) => `<b class="side-${name}">${escaped(PICTURES[name].words)}</b>`;
    const held = looking.shift && this.which === "ours" ? ", Shift is held" : "";
    this.caption.innerHTML = `${named(left)}${right ? ` | ${named(right)}` : ""} <span>${escaped(layer + held)}</span>`;
    this.canvas.setAttribute("aria-label", `${words}, ${layer} of ${looking.record.scene.name}`);
    const image = looking.bitmaps[left];
    this.caption.title = this.caption.innerText;
    this.legend.innerHTML = image ? legendHtml(image.legend) : "";
    this.element.classList.toggle("turned", left === "reference" && this.which !== "reference");
  }

  fit() {
    const box = this.stage.getBoundingClientRect(), dense = devicePixelRatio || 1;
    Object.assign(this, { width: box.width, height: box.height, dense });
    this.canvas.width = Math.round(box.width * dense);
    this.canvas.height = Math.round(box.height * dense);
  }

  get scale() {
    const { record } = looking;
    return state.z > 0 ? state.z : Math.min(this.width / record.width, this.height / record.height);
  }

  /** Where the corner of film pixel (x, y) is on the canvas. */
  place(x, y) {
    const [cx, cy] = center();
    return [this.width / 2 + (x - cx) * this.scale, this.height / 2 + (y - cy) * this.scale];
  }

  /** Film coordinates of a point on the canvas. */
  film(px, py) {
    const [cx, cy] = center();
    return [cx + (px - this.width / 2) / this.scale, cy + (py - this.height / 2) / this.scale];
  }

  draw() {
    const { context, dense } = this, [left, right] = this.sources();
    context.setTransform(dense, 0, 0, dense, 0, 0);
    context.clearRect(0, 0, this.width, this.height);
    if (!looking.bitmaps[left]) return this.drawMessage();
    const wiped = right ? this.width * state.w : this.width;
    this.drawImage(left, 0, wiped);
    if (right) this.drawImage(right, wiped, this.width), this.handle(wiped);
    if (this.scale >= GRID_FROM) this.grid();
    if (this.scale >= NUMBERS_FROM && (left === "ours" || left === "reference")) this.numbers(left);
    if (this.scale < GRID_FROM) this.rings();
    this.cursor();
  }

  drawMessage() {
    const { layer, missing } = looking.data;
    const why = missing || (layer.name === "all" ? "no image of all checks together: see difference over bound"
      : this.which === "ratio" && !layer.check ? `no check compares the ${layer.words}`
      : "not stored");
    this.context.fillStyle = getComputedStyle(this.stage).color;
    this.context.font = "13px system-ui, sans-serif";
    this.context.textAlign = "center";
    wrapped(why, Math.floor(this.width / 7)).forEach((line, i) =>
      this.context.fillText(line, this.width / 2, this.height / 2 + 18 * i));
  }

  drawImage(name, from, to) {
    const { context } = this, { record, bitmaps } = looking;
    const [x, y] = this.place(record.x0, record.y0);
    context.save();
    context.beginPath();
    context.rect(from, 0, to - from, this.height);
    context.clip();
    context.imageSmoothingEnabled = this.scale < 1;
    context.drawImage(bitmaps[name].bitmap, x, y, record.width * this.scale, record.height * this.scale);
    if (looking.veil) context.drawImage(looking.veil, x, y, record.width * this.scale, record.height * this.scale);
    context.restore();
  }

  handle(x) {
    this.context.fillStyle = "#fff";
    this.context.fillRect(x - 1, 0, 2, this.height);
    this.context.strokeStyle = "#000";
    this.context.strokeRect(x - 1.5, -1, 3, this.height + 2);
  }

  /** First and last visible film pixels. */
  visible() {
    const { record } = looking, [x0, y0] = this.film(0, 0), [x1, y1] = this.film(this.width, this.height);
    return [Math.max(record.x0, Math.floor(x0)), Math.max(record.y0, Math.floor(y0)),
      Math.min(record.x0 + record.width, Math.ceil(x1)), Math.min(record.y0 + record.height, Math.ceil(y1))];
  }

  grid() {
    const { context } = this, [x0, y0, x1, y1] = this.visible();
    const [left, top] = this.place(x0, y0), [right, bottom] = this.place(x1, y1);
    context.strokeStyle = "rgba(128,128,128,0.35)";
    context.lineWidth = 1;
    context.beginPath();
    const line = (...ends) => (context.moveTo(...ends.slice(0, 2)), context.lineTo(...ends.slice(2)));
    for (let x = x0; x <= x1; x++) line(this.place(x, 0)[0], top, this.place(x, 0)[0], bottom);
    for (let y = y0; y <= y1; y++) line(left, this.place(0, y)[1], right, this.place(0, y)[1]);
    context.stroke();
  }

  numbers(side) {
    const { context } = this, { record, data } = looking, [x0, y0, x1, y1] = this.visible();
    context.font = "12px ui-monospace, monospace";
    context.lineJoin = "round";
    context.textAlign = "center";
    for (let y = y0; y < y1; y++) for (let x = x0; x < x1; x++) {
      const row = record.row(x, y), [px, py] = this.place(x + 0.5, y + 0.5);
      for (let c = 0; c < data.channels; c++) {
        const value = Number(data[side][c * data.count + row]), exact = !data.steps || record.placeOf(row) >= 0;
        const words = exact || !Number.isFinite(value) ? brief(value) : `\u2248${roundedTo(value, data.steps[c])}`;
        const down = py + NUMBER_LINES[data.channels][c];
        context.strokeStyle = "rgba(0,0,0,0.75)";
        context.lineWidth = 3;
        context.strokeText(words, px, down);
        context.fillStyle = "#fff";
        context.fillText(words, px, down);
      }
    }
  }

  /** Around failing pixels, which are too small to find among others; on the class map, if none fails,
   *  around those that do not plainly agree. */
  rings() {
    const { context } = this, { record } = looking;
    context.lineWidth = 1.25;
    const marks = this.which === "class" && !record.failing.length ? record.unlikeMarks : record.failingMarks;
    for (const row of marks.filter((each) => !looking.chosen || looking.chosen.has(each))) {
      const [x, y] = record.pixel(row), [px, py] = this.place(x + 0.5, y + 0.5);
      context.strokeStyle = css(CLASS_COLORS[RUN.classes[record.classes[row]]]);
      context.beginPath();
      context.arc(px, py, Math.max(5, this.scale), 0, 2 * Math.PI);
      context.stroke();
    }
  }

  cursor() {
    const { context } = this, size = Math.max(3, this.scale);
    for (const [row, color] of [[looking.under, "rgba(255,255,255,0.6)"], [pinnedRow(), "#fff"]]) {
      if (row < 0) continue;
      const [px, py] = this.place(...looking.record.pixel(row));
      context.lineWidth = 3;
      context.strokeStyle = "rgba(0,0,0,0.8)";
      context.strokeRect(px - 1, py - 1, size + 2, size + 2);
      context.lineWidth = 1.5;
      context.strokeStyle = color;
      context.strokeRect(px - 1, py - 1, size + 2, size + 2);
    }
  }
}

function wrapped(text, width) {
  return text.split(" ").reduce((lines, word) => {
    const last = lines[lines.length - 1];
    if (last.length + word.length < width) lines[lines.length - 1] = `${last} ${word}`.trim();
    else lines.push(word);
    return lines;
  }, [""]);
}

// The inspector: every value, bound and explanation of one pixel.

let inspected = new Map(); // layer name -> its data, `share CHECK` -> its shares, as far as unpacked
let shownPixel = "";

/** The pixel under the pointer, or else the pinned one. */
function showPixel() {
  const { record, under } = looking, box = byId("pixel");
  const row = under >= 0 ? under : pinnedRow();
  const key = `${record.scene.name} ${row} ${under >= 0} ${state.a} ${inspected.size}`;
  if (key === shownPixel) return;
  shownPixel = key;
  box.innerHTML = row < 0 ? hintHtml(record) : pixelHtml(record, row, under >= 0);
}

function hintHtml(record) {
  const bad = record.failing.length, rows = bad || record.unlike.length;
  const what = bad ? "failing pixel" : COMPARED ? "pixel that differs most" : "pixel that passes without agreeing";
  const next = rows ? `<kbd>n</kbd> goes to the next group, <kbd>.</kbd> to the next of ${pluralOf(rows, what)}.` : "";
  const names = RUN.classes.filter((_, code) => record.classes.includes(code));
  return `${evidenceHtml(record)}<h2>No pixel is pinned</h2><p>Point at a pixel to read it, click to pin it. ${next}</p>
<p class="note">Hold <kbd>Shift</kbd> to see ${escaped(THE_REFERENCE)} in place of ${escaped(THE_JUDGED)}. The wheel zooms,
dragging pans, and <kbd>?</kbd> lists the keys and explains the words.</p>
${names.length ? `<h3>Classes of pixels here</h3>${legendOfClasses(names)}` : ""}`;
}

const pluralOf = (count, what) => (count === 1 ? `1 ${what}` : `${grouped(count)} ${what.replace("pixel", "pixels").replace("passes", "pass").replace("that differs", "that differ")}`);
const plural = (count, what) => `${grouped(count)} ${what}${count === 1 ? "" : "s"}`;

function pixelHtml(record, row, hovering) {
  const [x, y] = record.pixel(row), name = RUN.classes[record.classes[row]], lossless = record.placeOf(row) >= 0;
  const pinned = hovering ? "under the pointer" : "pinned";
  const replay = COMPARED ? "" : `<div class="replay"><code>${escaped(replayOf(record, x, y))}</code>
<button type="button" data-do="copy" title="copy (c)">copy</button></div>`;
  const judged = COMPARED ? "" : `<p class="class" title="${escaped(classWords(name))}"><i style="background:${css(CLASS_COLORS[name])}"></i><b>${className(name)}${isShadow(record, row) ? ", a shadow" : ""}</b>:
${escaped(why(record, row))}</p>
${factsHtml(record, row)}`;
  return `<h2>Pixel <span class="xy">${x}, ${y}</span> <small>${pinned}</small> <button type="button" data-do="values" title="copy all values (v)">copy values</button></h2>
${judged}${replay}
${RUN.candidate ? `<p class="note">The whole scene again: <code>${escaped(record.scene.replay)}</code></p>` : ""}
${lossless ? "" : '<p class="note">Numbers with \u2248 are stored rounded; the command prints all their digits.</p>'}
${inspectorLayers(record, row).map((layer) => layerHtml(record, row, layer)).join("")}${notGivenHtml(record)}`;
}

function why(record, row) {
  const { reasons } = record.about, entry = record.reasons.get(row);
  if (entry) return reasons.texts[entry[0]];
  return reasons.always[record.classes[row]] ?? "no reason is stored for so many pixels";
}

/** Whether both sides see the same point of the same surface, and only its light differs. */
function isShadow(record, row) {
  if (record.hits[row] !== 3 || record.shape_ours?.[row] !== record.shape_reference?.[row]) return false;
  const share = (name) => inspected.get(name)?.ratio?.[row] ?? 0;
  return share("diffuse") > 1 && ["depth", "normal", "position"].every((name) => share(name) <= 1);
}

/** Shapes, the exact answer, and checks without a layer. */
function factsHtml(record, row) {
  const facts = [["ours", sideWords(record, row, "ours", 1)], ["reference", sideWords(record, row, "reference", 2)]];
  const answer = record.exact.get(row);
  if (answer) {
    const [t, words] = answer, share = inspected.get("share exact")?.[row] ?? 0, at = Number.isFinite(t) ? `<br>t ${numberHtml(t)}` : "";
    const text = escaped(record.about.exact.texts[words]);
    const how = Number.isNaN(t) ? "" : share === Infinity ? `no bound allows ${RUN.candidate ? "the candidate's answer" : "our answer"}`
      : `${JUDGED} uses ${atMost(share)} of its bound`;
    facts.push(["exact", `${text}${at}<br>${how}`]);
  } else {
    facts.push(["exact", isShadow(record, row) ? "not needed: the surface is the same, and light is compared in float64" : "not computed here"]);
  }
  const others = ["mask", "shape_id", "on_surface"].map((name) => [name, inspected.get(`share ${name}`)?.[row]])
    .filter(([, share]) => share > 0);
  const used = ([name, share]) =>
    `<span class="${share > 1 ? "bad" : ""}">${spaced(name)} ${share === Infinity ? "fails" : atMost(share)}</span>`;
  if (others.length) facts.push(["checks", others.map(used).join(", ")]);
  const entry = ([term, words]) => `<dt class="side-${term}">${sideName(term)}</dt><dd>${words}</dd>`;
  return `<dl>${facts.map(entry).join("")}</dl>`;
}

/** The shape that one side hits, and its t where that is stored. */
function sideWords(record, row, side, bit) {
  if (!(record.hits[row] & bit)) return "miss";
  const place = record.placeOf(row), t = place >= 0 && record[`t_${side}`], shape = record[`shape_${side}`]?.[row], prim = record[`prim_${side}`]?.[row];
  const what = shape === undefined ? "hit" : `${record.about.shapes[shape] ?? `shape ${shape}`}, prim ${prim}`;
  return escaped(what) + (t ? `<br>t ${numberHtml(t[place])}` : "");
}

/** Quantities that the candidate does not give. */
function notGivenHtml(record) {
  const names = record.verdict?.unjudged ?? [];
  const words = names.map((name) => LAYERS.find((layer) => layer.name === name)?.words ?? spaced(name)).join(", ");
  return words && `<section><p class="note">Not given by the candidate, and not judged: ${words}.</p></section>`;
}

/** The current layer first, then those beyond their bound, then the other float layers. */
function inspectorLayers(record, row) {
  const beyond = (layer) => (inspected.get(layer.name)?.ratio?.[row] > 1 ? 1 : 0);
  const rank = (layer) => (layer.name === state.a ? 2 : beyond(layer));
  return record.layers.filter(isFloat).sort((one, other) => rank(other) - rank(one));
}

function layerHtml(record, row, layer) {
  const data = inspected.get(layer.name);
  if (!data || notGiven(record, layer)) return "";
  if (data.missing)
    return `<section><h3>${layer.words}</h3><p class="note">not stored</p></section>`;
  if (record.hits[row] === 0) return "";
  const names = CHANNELS[layer.kind], both = record.hits[row] === 3;
  const lossless = record.placeOf(row) >= 0;
  const rows = names.map((name, c) => channelHtml(name, data, c, row, record.hits[row], lossless)).join("")
    + (lossless || !both ? "" : `<tr class="apart"><td colspan="3">\u0394 ${errorWords(data.difference[row])}</td></tr>`);
  return `<section><h3>${escaped(layer.words)} ${both ? boundHtml(record, data, row) : "<small>not compared</small>"}</h3><table>
<thead><tr><th></th><th scope="col" class="side-ours">${escaped(JUDGED)}</th>
<th scope="col" class="side-reference">${escaped(REFERENCE)}</th></tr></thead>
<tbody>${rows}</tbody></table></section>`;
}

/** A rounded share is rounded up; below the least one that is stored, it is 0. */
function atMost(share) {
  const least = 2 ** -RUN.codes.octaves;
  return share === 0 ? `under ${brief(least)} \u00d7` : `${brief(share)} \u00d7`;
}

/** A rounded error: its size up to a factor of the root of 2; 0 if it is too small to be seen beside others. */
const errorWords = (error) => (error === 0 ? "too small to be drawn" : `about ${error < 0 ? "\u2212" : ""}${Number(Math.abs(error).toPrecision(1))}`);

/** The share of the bound; a candidate has that of its own arithmetic, on its distance from the surface in float64. */
function boundHtml(record, data, row) {
  if (!data.ratio) return "";
  const share = data.ratio[row], lossless = record.placeOf(row) >= 0;
  const bound = RUN.candidate ? `${record.verdict.precision}\u2019s bound` : "its bound";
  const used = lossless ? `${brief(share)} \u00d7 ${bound}` : `${share === 0 ? "" : "at most "}${atMost(share)} ${bound}`;
  return `<small class="${share > 1 ? "bad" : ""}">${share === Infinity ? "no bound holds" : used}</small>`;
}

/** hits: 1 for ours, 2 for the reference; on a miss there is no number to show. */
function channelHtml(name, data, c, row, hits, lossless) {
  const at = c * data.count + row, ours = data.ours[at], reference = data.reference[at];
  const number = (value) => (lossless || !Number.isFinite(value) ? numberHtml(value) : `<span class="number">\u2248 ${roundedTo(value, data.steps[c])}</span>`);
  const shown = (value, bit) => (hits & bit ? number(value) : '<span class="number odd">miss</span>');
  const both = `<tr><th scope="row" rowspan="${lossless ? 2 : 1}">${name}</th><td>${shown(ours, 1)}</td><td>${shown(reference, 2)}</td></tr>`;
  return lossless ? `${both}<tr class="apart"><td colspan="2">${hits === 3 ? apartWords(ours, reference) : "hit on one side only"}</td></tr>` : both;
}

function numberHtml(value) {
  const odd = Number.isFinite(value) ? "" : "odd";
  return `<span class="number ${odd}">${decimal(value)}<small>${hex(value)}</small></span>`;
}

function apartWords(ours, reference) {
  if (Object.is(ours, reference) || ours === reference) {
    return Number.isNaN(ours) ? "both are NaN, which never agrees" : "the same number";
  }
  if (Number.isNaN(ours) || Number.isNaN(reference)) return "NaN on one side: the difference is undefined";
  if (!Number.isFinite(ours) || !Number.isFinite(reference)) return "infinite on one side";
  const signed = (value) => `${value < 0 ? "\u2212" : ""}${brief(Math.abs(value))}`;
  return `\u0394 ${signed(ours - reference)}, ${signed(ulps(ours, reference))} ulp of float32`;
}

/** The command that replays this pixel. */
function replayOf(record, x, y) {
  const { bounce, view, replay, replay_pixel: [before, after] } = record.scene;
  if (!bounce) return `${before}${x} ${y}${after}`;
  const [x0, y0, rows] = view;
  return y < rows ? `${before}${x0 + x} ${y0 + y}${after}` : replay;
}

function copyReplay() {
  const { record } = looking, row = pinnedRow();
  if (!record || COMPARED) return;
  copyText(row < 0 ? record.scene.replay : replayOf(record, ...record.pixel(row)));
}

/** Copy what is known of the pinned pixel: a line for each channel, tab between the sides. */
function copyValues() {
  const { record } = looking, row = looking.under >= 0 ? looking.under : pinnedRow();
  if (!record || row < 0) return showStatus("no pixel is pinned");
  const [x, y] = record.pixel(row), lossless = record.placeOf(row) >= 0;
  const lines = [`${record.scene.name} pixel ${x} ${y}${lossless ? "" : ", rounded"}\t${JUDGED}\t${REFERENCE}`];
  if (!COMPARED) lines.push(`class\t${RUN.classes[record.classes[row]]}\t${why(record, row)}`);
  for (const layer of inspectorLayers(record, row)) {
    const data = inspected.get(layer.name);
    if (!data?.ours) continue;
    CHANNELS[layer.kind].forEach((name, c) => {
      const at = c * data.count + row, value = (side, bit) => (record.hits[row] & bit ? decimal(data[side][at]) : "miss");
      lines.push(`${layer.name}${name && `.${name}`}\t${value("ours", 1)}\t${value("reference", 2)}`);
    });
  }
  copyText(lines.join("\n"), `values of pixel ${x}, ${y}`);
}

async function copyText(words, named = words) {
  try {
    await navigator.clipboard.writeText(words);
  } catch {
    copyBySelection(words);
  }
  showStatus(`copied: ${named}`);
}

function copyBySelection(words) {
  const area = document.createElement("textarea");
  area.value = words;
  document.body.append(area);
  area.select();
  document.execCommand("copy");
  area.remove();
}

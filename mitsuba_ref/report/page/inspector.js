// The inspector: every value, bound and explanation of one pixel.

let inspected = new Map(); // layer name -> its data, `share CHECK` -> its shares, as far as unpacked
let shownPixel = "";

/** The pixel under the pointer, or else the pinned one. */
function showPixel() {
  const { record, under } = looking, box = document.getElementById("pixel");
  const row = under >= 0 ? under : pinnedRow();
  const key = `${record.scene.name} ${row} ${under >= 0} ${state.a} ${inspected.size}`;
  if (key === shownPixel) return;
  shownPixel = key;
  box.innerHTML = row < 0 ? hintHtml(record) : pixelHtml(record, row, under >= 0);
}

function hintHtml(record) {
  const bad = record.failing.length;
  const next = bad ? `<kbd>n</kbd> goes to the next group, <kbd>.</kbd> to the next of ${plural(bad, "failing pixel")}.`
    : record.unlike.length
      ? `<kbd>n</kbd> goes to the next group, <kbd>.</kbd> to the next of ${plural(record.unlike.length, "pixel")} that pass without agreeing.` : "";
  return `<h2>No pixel is pinned</h2><p>Point at a pixel to read it, click to pin it. ${next}</p>
<p class="note">Hold <kbd>Shift</kbd> to see the reference in place of ${THE_JUDGED}. The wheel zooms,
dragging pans, and <kbd>?</kbd> lists the keys.</p>`;
}

const plural = (count, what) => `${grouped(count)} ${what}${count === 1 ? "" : "s"}`;

function pixelHtml(record, row, hovering) {
  const [x, y] = record.pixel(row), name = RUN.classes[record.classes[row]];
  const pinned = hovering ? "under the pointer" : "pinned";
  return `<h2>Pixel <span class="xy">${x}, ${y}</span> <small>${pinned}</small></h2>
<p class="class"><i style="background:${css(CLASS_COLORS[name])}"></i><b>${className(name)}</b>:
${escaped(why(record, row))}</p>
${factsHtml(record, row)}
<div class="replay"><code>${escaped(replayOf(record, x, y))}</code>
<button type="button" data-do="copy" title="copy (c)">copy</button></div>
${RUN.candidate ? `<p class="note">The whole scene again: <code>${escaped(record.scene.replay)}</code></p>` : ""}
${inspectorLayers(row).map((layer) => layerHtml(record, row, layer)).join("")}${notGivenHtml(record)}`;
}

function why(record, row) {
  const { reasons } = record.about, entry = record.reasons.get(row);
  if (entry) return reasons.texts[entry[0]];
  return reasons.always[record.classes[row]] ?? "no reason is stored for so many pixels";
}

/** Shapes, the exact answer, and checks without a layer. */
function factsHtml(record, row) {
  const facts = [["ours", sideWords(record, row, "ours", 1)], ["reference", sideWords(record, row, "reference", 2)]];
  const answer = record.exact.get(row);
  if (answer) {
    const [t, share, words] = answer, at = Number.isFinite(t) ? `<br>t ${numberHtml(t)}` : "";
    const text = escaped(record.about.exact.texts[words]);
    const how = Number.isNaN(t) ? "" : share === Infinity ? `no bound allows ${RUN.candidate ? "the candidate's answer" : "our answer"}`
      : `${JUDGED} uses ${brief(share)} \u00d7 its bound`;
    facts.push(["exact", `${text}${at}<br>${how}`]);
  } else {
    facts.push(["exact", "not computed here"]);
  }
  const others = ["mask", "shape_id", "on_surface", "exact"].filter((name) => inspected.has(`share ${name}`))
    .map((name) => [name, inspected.get(`share ${name}`)[row]]);
  const used = ([name, share]) =>
    `<span class="${share > 1 ? "bad" : ""}">${spaced(name)} ${share === Infinity ? "fails" : brief(share)}</span>`;
  if (others.length) facts.push(["checks", others.map(used).join(", ")]);
  const entry = ([term, words]) => `<dt class="side-${term}">${sideName(term)}</dt><dd>${words}</dd>`;
  return `<dl>${facts.map(entry).join("")}</dl>`;
}

/** The shape that one side hits, and its t where that is stored. */
function sideWords(record, row, side, bit) {
  if (!(record.hits[row] & bit)) return "miss";
  const t = record[`t_${side}`], shape = record[`shape_${side}`]?.[row], prim = record[`prim_${side}`]?.[row];
  const what = shape === undefined ? "hit" : `${record.about.shapes[shape] ?? `shape ${shape}`}, prim ${prim}`;
  return escaped(what) + (t ? `<br>t ${numberHtml(t[row])}` : "");
}

/** Quantities that the candidate does not give. */
function notGivenHtml(record) {
  const names = record.verdict.unjudged ?? [];
  const words = names.map((name) => LAYERS.find((layer) => layer.name === name)?.words ?? spaced(name)).join(", ");
  return words && `<section><p class="note">Not given by the candidate, and not judged: ${words}.</p></section>`;
}

/** The current layer first, then those beyond their bound, then the other float layers. */
function inspectorLayers(row) {
  const beyond = (layer) => (inspected.get(layer.name)?.ratio?.[row] > 1 ? 1 : 0);
  const rank = (layer) => (layer.name === state.a ? 2 : beyond(layer));
  return LAYERS.filter(isFloat).sort((one, other) => rank(other) - rank(one));
}

function layerHtml(record, row, layer) {
  const data = inspected.get(layer.name);
  if (!data || notGiven(record, layer)) return "";
  if (data.missing)
    return `<section><h3>${layer.words}</h3><p class="note">not stored</p></section>`;
  if (record.hits[row] === 0) return "";
  const names = CHANNELS[layer.kind], both = record.hits[row] === 3;
  const rows = names.map((name, c) => channelHtml(name, data, c * data.count + row, record.hits[row])).join("");
  return `<section><h3>${layer.words} ${both ? boundHtml(record, data, row) : "<small>not compared</small>"}</h3><table>
<thead><tr><th></th><th scope="col" class="side-ours">${JUDGED}</th>
<th scope="col" class="side-reference">reference</th></tr></thead>
<tbody>${rows}</tbody></table></section>`;
}

/** The bound of a candidate is that of its own arithmetic, on its distance from the surface in float64. */
function boundHtml(record, data, row) {
  if (!data.ratio) return "";
  const share = data.ratio[row];
  const bound = data.own ? `${record.verdict.precision}\u2019s bound ${brief(data.own[row])}`
    : data.alone?.[row] ? "float64\u2019s bound" : data.bound ? `bound ${brief(data.bound[row])}` : "its bound";
  const used = `${brief(share)} \u00d7 ${bound}`;
  const words = share === Infinity ? "no bound holds" : used;
  return `<small class="${share > 1 ? "bad" : ""}">${words}</small>`;
}

/** hits: 1 for ours, 2 for the reference; on a miss there is no number to show. */
function channelHtml(name, data, at, hits) {
  const ours = data.ours[at], reference = data.reference[at];
  const shown = (value, bit) => (hits & bit ? numberHtml(value) : '<span class="number odd">miss</span>');
  return `<tr><th scope="row" rowspan="2">${name}</th><td>${shown(ours, 1)}</td><td>${shown(reference, 2)}</td></tr>
<tr class="apart"><td colspan="2">${hits === 3 ? apartWords(ours, reference) : "hit on one side only"}</td></tr>`;
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
  const [before, after] = record.scene.replay_pixel;
  return `${before}${x} ${y}${after}`;
}

async function copyReplay() {
  const { record } = looking, row = pinnedRow();
  if (!record) return;
  const words = row < 0 ? record.scene.replay : replayOf(record, ...record.pixel(row));
  try {
    await navigator.clipboard.writeText(words);
  } catch {
    copyBySelection(words);
  }
  showStatus(`copied: ${words}`);
}

function copyBySelection(words) {
  const area = document.createElement("textarea");
  area.value = words;
  document.body.append(area);
  area.select();
  document.execCommand("copy");
  area.remove();
}

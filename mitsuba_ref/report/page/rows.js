// One row of the list.

function rowHtml(scene, i, height) {
  const [check, share] = shownShare(scene);
  const current = scene.name === currentName ? " current" : "";
  const name = escaped(scene.name);
  const size = scene.size[0] ? `${scene.size[0]} \u00d7 ${scene.size[1]}` : "";
  const note = scene.ok ? size : firstWords(scene);
  return `<div class="row${current}" role="row" aria-rowindex="${i + 2}" style="top:${i * height}px">
<span class="thumbnail" role="cell">${scene.thumbnail ? `<img src="${scene.thumbnail}" alt="">` : ""}</span>
<span class="mark" role="cell">${markHtml(scene)}</span>
<span class="name" role="cell">
<a href="${escaped(address({ ...CLOSE, s: scene.name }))}" data-scene="${name}">${name}</a>
<small title="${escaped(scene.failure)}">${escaped(note)}</small></span>
<span class="classes" role="cell">${classBar(scene)}<small>${classCounts(scene)}</small></span>
<span class="worst" role="cell">${scene.failing ? failingHtml(scene, check, share) : check ? shareHtml(check, share) : ""}</span>
<span class="adjudicated" role="cell">${grouped(scene.adjudicated)}</span>
<span class="time" role="cell">${scene.seconds.toFixed(1)} s</span></div>`;
}

const CLOSE = { a: "", x: -1, y: -1, z: 0, cx: -1, cy: -1, e: 0, of: 0, lo: "", hi: "" };

const firstWords = (scene) => scene.failure.split("\n")[0].replace(/^[A-Z]+\s+/, "").replace(scene.name, "").trim();

function markHtml(scene) {
  const words = scene.mark === "FAIL" && scene.crashed && !RUN.candidate ? "CRASH" : scene.mark;
  const title = { KNOWN: "listed as a known failure: the run does not fail by it", SKIP: "declined by the candidate" }[words];
  return `<span class="badge ${scene.mark.toLowerCase()}" title="${title ?? ""}">${words}</span>`;
}

/** A bar in proportion, of at least six points, so that one pixel in a hundred thousand stays visible. */
function classBar(scene) {
  const parts = countsOf(scene).filter(([, count]) => count);
  const bars = parts.map(([name, count]) =>
    `<i style="flex-grow:${count};background:${css(CLASS_COLORS[name])}" title="${className(name)}: ${count}. ${escaped(classWords(name))}"></i>`);
  return `<span class="classbar" aria-hidden="true">${bars.join("")}</span>`;
}

/** [class, pixels]; unlisted errors of the reference are counted apart from known ones. */
function countsOf(scene) {
  const counts = { ...scene.counts, unlisted: scene.unlisted };
  counts.reference_wrong -= scene.unlisted;
  return Object.entries(counts);
}

function classCounts(scene) {
  const bad = (name) => (FAILING.has(name) ? "bad" : "");
  const words = countsOf(scene).filter(([, count]) => count)
    .map(([name, count]) => `<span class="${bad(name)}">${grouped(count)} ${className(name)}</span>`);
  return words.join(", ") || "no pixel was compared";
}

function shareHtml(check, share) {
  const width = Math.min(100, 100 * (share || 0));
  const hundredths = brief(share < 10 ? Number(share.toFixed(2)) : share);
  const small = share > 0 && share < 0.01 ? share.toExponential(0) : hundredths;
  const words = share === Infinity ? "no bound holds:" : share > 1 ? `${small}\u00d7` : small;
  return `<span class="meter ${share > 1 ? "over" : ""}" aria-hidden="true"><i style="width:${width}%"></i></span>
<small><b>${words}</b> ${spaced(check)}</small>`;
}

/** The share of failing pixels of a scene that fails; a meter cannot show more than the whole of a bound. */
function failingHtml(scene, check, share) {
  const of = Math.max(scene.hit_pixels, scene.failing), percent = (100 * scene.failing) / of;
  const factor = share > 1 ? `, ${spaced(check)} ${share === Infinity ? "beyond any bound" : `${brief(share)}\u00d7`}` : "";
  const words = percent > 99.95 && percent < 100 ? "99.9" : percent < 0.1 ? "under 0.1" : String(Number(percent.toFixed(1)));
  return `<span class="meter over" aria-hidden="true" title="pixels that fail"><i style="width:${Math.max(2, percent)}%"></i></span>
<small title="${grouped(scene.failing)} of ${grouped(of)} pixels fail${escaped(factor)}"><b>${words} %</b> fail${factor}</small>`;
}

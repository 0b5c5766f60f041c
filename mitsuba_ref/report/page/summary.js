// Summary of a scene, beside its images.

function fillSummary(record) {
  byId("summary").innerHTML = COMPARED ? comparisonHtml(record) : judgedHtml(record);
}

/** Numbers about two images, which are information and no verdict, and what the command printed. */
function comparisonHtml({ about }) {
  const facts = about.facts.map(([term, words]) => `<dt>${escaped(term)}</dt><dd>${escaped(words)}</dd>`).join("");
  return `<h2>${escaped(JUDGED)} and ${escaped(REFERENCE)}</h2><dl class="facts">${facts}</dl><pre>${escaped(about.text)}</pre>`;
}

function judgedHtml({ verdict, scene }) {
  const broken = verdict.checks.filter((check) => !check.ok), held = verdict.checks.length - broken.length;
  const worst = verdict.failures.map(failureHtml).join("");
  const versions = Object.entries(verdict.versions).map(([name, version]) => `${name} ${version}`).join(", ");
  return `<h2>${plural(verdict.hit_pixels, "pixel")} that hit</h2>
<table>${countsOf(scene).filter(([, count]) => count).map(countHtml).join("")}</table>
<p>${grouped(verdict.adjudicated)} pixels were decided by exact arithmetic. ${held} of ${verdict.checks.length} scene checks pass.</p>
${broken.length ? `<ul>${broken.map(brokenHtml).join("")}</ul>` : ""}
${foundHtml(verdict)}
${worst ? `<h3>${RUN.candidate ? "Some" : "Worst"} failing pixels</h3><ol>${worst}</ol>` : ""}
${(verdict.notes ?? []).map((note) => `<p class="note">${escaped(note)}</p>`).join("")}
<p class="note">${escaped(RUN.candidate ? `held to the bounds of ${verdict.precision}; ${versions}` : versions)}</p>`;
}

/** The causes, those of most pixels first; each has a button that shows its pixels alone. */
function foundHtml(verdict) {
  const each = ({ pixels, what, x, y }, i) => `<li>
<button type="button" class="cause" data-cause="${i}" aria-pressed="${state.f === i}" title="these pixels alone">${plural(pixels, "pixel")}</button>
first <a href="${escaped(address({ x, y }))}" data-x="${x}" data-y="${y}">${x}, ${y}</a>: ${escaped(what)}</li>`;
  return verdict.findings?.length ? `<h3>What is wrong</h3><ul>${verdict.findings.map(each).join("")}</ul>` : "";
}

function countHtml([name, count]) {
  const box = `<i style="background:${css(CLASS_COLORS[name])}"></i>`;
  return `<tr title="${escaped(classWords(name))}"><td>${box}${className(name)}</td><td>${grouped(count)}</td></tr>`;
}

function brokenHtml(check) {
  return `<li class="bad"><button type="button" data-do="evidence">${spaced(check.name)}</button> ${times(numberOf(check.ratio))}; ${escaped(check.what)}</li>`;
}

function failureHtml({ x, y, verdict, check, ratio }) {
  return `<li><a href="${escaped(address({ x, y }))}" data-x="${x}" data-y="${y}">${x}, ${y}</a> ${className(verdict)}<br>
<small class="quiet">${spaced(check)}: ${times(numberOf(ratio))}</small></li>`;
}

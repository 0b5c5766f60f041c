// The evidence of scene checks, which have no single pixel: shares of their bounds, and signed errors.

/** Unpin, and show what the first failing check rests on, at a layer and view that show it. */
function showEvidence(record) {
  const [check] = failedChecks(record), place = /\((\d+), (\d+)\)/.exec(check.what);
  const row = place ? record.row(+place[1], +place[2]) : -1;
  change({ x: -1, y: -1, ...(BIASES.has(check.name) ? { a: "depth", v: "difference", lo: "", hi: "" } : {}) });
  if (row >= 0) pin(row);
  looking.under = -1;
  showLayer(++turn);
  showStatus(`${check.name}: ${times(numberOf(check.ratio))}`);
}

const BIASES = new Set(["bias", "t_bias"]);

/** The failing checks with what they say, as the inspector shows them where no pixel is pinned. */
function evidenceHtml(record) {
  return failedChecks(record).map((check) => `<section class="evidence">
<h2>${spaced(check.name)} <span class="bad">${times(numberOf(check.ratio))}</span></h2>
<p>${escaped(RUN.checks[check.name] ?? "")}</p><p class="bad">${escaped(check.what)}</p>
${check.name === "bias" ? kindsHtml(record.verdict.biases) : ""}${BIASES.has(check.name) ? signsHtml(record) : ""}
${check.name === "knife_edges" ? raysHtml(record) : ""}</section>`).join("") + (failedChecks(record).length ? checksHtml(record) : "");
}

/** A bar from the middle for each kind of shape: how far its mean error is from 0, in standard deviations. */
function kindsHtml(kinds) {
  const most = Math.max(6, ...kinds.map(({ z }) => Math.abs(z)));
  const bar = ({ kind, z, quantity, groups, enough_groups }) => `<tr><th scope="row">${escaped(kind)}</th>
<td>${middleBar(z / most, enough_groups && Math.abs(z) > RUN.largest_z, RUN.largest_z / most)}</td>
<td>${z.toFixed(1)}</td><td class="quiet">${enough_groups ? `${quantity}, ${groups} groups` : "too few groups"}</td></tr>`;
  return `<h3>Mean error of each kind, in standard deviations; chance gives ${RUN.largest_z} at most</h3><table class="bars">${kinds.map(bar).join("")}</table>`;
}

function middleBar(share, bad, limit) {
  const left = share < 0 ? 50 + 50 * share : 50, mark = (at) => `<line x1="${at}" x2="${at}" y1="0" y2="10"/>`;
  return `<svg viewBox="0 0 100 10" preserveAspectRatio="none" role="img" aria-label="${share.toFixed(2)}"><rect class="${bad ? "over" : ""}" x="${left}" y="2" width="${50 * Math.abs(share)}" height="6"/>${[50, 50 - 50 * limit, 50 + 50 * limit].map(mark).join("")}</svg>`;
}

const SIGN_BINS = 20;

/** Pixels by the signed share of their depth's bound: even, if the errors are random. */
function signsHtml(record) {
  const data = inspected.get("depth");
  if (!data?.ratio) return "";
  const bins = new Array(2 * SIGN_BINS).fill(0);
  let sum = 0, count = 0;
  for (let i = 0; i < data.count; i++) {
    if (record.hits[i] !== 3 || !(data.ratio[i] <= 1) || !data.ratio[i]) continue;
    const share = Math.sign(data.difference[i]) * data.ratio[i];
    bins[Math.min(2 * SIGN_BINS - 1, Math.floor((share + 1) * SIGN_BINS))]++;
    sum += Math.sign(share), count++;
  }
  const most = Math.max(1, ...bins), positive = count ? (50 * (1 + sum / count)).toFixed(1) : "50";
  const bars = bins.map((n, i) => `<rect x="${i}" y="${40 - (40 * n) / most}" width="0.9" height="${(40 * n) / most}"/>`).join("");
  return `<h3>Signed errors of the depth, over the bound</h3>
<svg class="signs" viewBox="0 0 ${2 * SIGN_BINS} 40" preserveAspectRatio="none" role="img" aria-label="histogram of signed shares">${bars}<line x1="${SIGN_BINS}" x2="${SIGN_BINS}" y1="0" y2="40"/></svg>
<p class="axis"><span>\u22121: ${THE_JUDGED} nearer</span><span>0</span><span>1: farther</span></p>
<p class="note">${positive} % of ${grouped(count)} pixels with an error of a sixteenth of the bound or more are farther than the reference.</p>`;
}

/** Some of the aimed rays that fail. */
function raysHtml(record) {
  return `<ol>${(record.about.wrong_rays ?? []).map((what) => `<li>${escaped(what)}</li>`).join("")}</ol>`;
}

/** Every scene check as a bar: how much of its bound it uses. */
function checksHtml(record) {
  const bar = ({ name, ratio, ok }) => {
    const share = numberOf(ratio), width = share > 0 ? Math.min(100, Math.max(1, share * 50)) : 0;
    return `<tr><th scope="row" title="${escaped(RUN.checks[name] ?? "")}">${spaced(name)}</th><td><span class="meter ${ok ? "" : "over"}"><i style="width:${width}%"></i><u></u></span></td><td>${share === Infinity ? "no bound" : brief(share)}</td></tr>`;
  };
  return `<section><h3>All scene checks; the line is the bound</h3><table class="bars">${record.verdict.checks.map(bar).join("")}</table></section>`;
}

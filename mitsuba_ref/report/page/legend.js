// Legends: a bar with numbers, and the meaning of colours that stand for no number.

function legendHtml(legend) {
  const swatches = (legend.swatches ?? []).map(swatchHtml).join("");
  const words = legend.words ? `<span class="words">${escaped(legend.words)}</span>` : "";
  return `${legend.colors ? barHtml(legend) : ""}<div class="keys">${words}${swatches}</div>`;
}

function barHtml({ colors, ticks }) {
  const marks = ticks.map(([share, words]) =>
    `<span style="left:${(100 * share).toFixed(2)}%" class="${share < 0.08 ? "first" : share > 0.92 ? "last" : ""}">` +
    `${escaped(words)}</span>`).join("");
  return `<div class="bar" style="background:${gradient(colors)}"></div><div class="ticks">${marks}</div>`;
}

function swatchHtml({ color, words, count }) {
  const box = `<i style="background:${css(color)}"></i>`;
  return `<span class="swatch">${box}${escaped(words)} <b>${grouped(count)}</b></span>`;
}

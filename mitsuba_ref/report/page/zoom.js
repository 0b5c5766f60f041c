// Zoom and position of the images, and redrawing them when these change.

function center() {
  const { record } = looking;
  const middle = [record.x0 + record.width / 2, record.y0 + record.height / 2];
  return [state.cx >= 0 ? state.cx : middle[0], state.cy >= 0 ? state.cy : middle[1]];
}

const pinnedRow = () => (looking.record ? looking.record.row(state.x, state.y) : -1);

/** Zoom by a factor; film point (x, y), or the middle, stays where it is. */
function zoomBy(factor, pane = looking.panes[0], point = null) {
  if (!pane || !looking.record) return;
  const [cx, cy] = center(), least = Math.min(pane.width / looking.record.width, pane.height / looking.record.height);
  const before = pane.scale, after = Math.min(MAX_ZOOM, before * factor);
  if (after <= least) return fitAll();
  const pinned = pinnedRow();
  const [x, y] = point ?? (pinned < 0 ? [cx, cy] : [state.x + 0.5, state.y + 0.5]);
  lookAt(x + ((cx - x) * before) / after, y + ((cy - y) * before) / after, after);
}

function lookAt(cx, cy, zoom = state.z) {
  const { record } = looking;
  const clamp = (value, low, size) => Math.min(low + size, Math.max(low, value));
  change({ cx: clamp(cx, record.x0, record.width), cy: clamp(cy, record.y0, record.height), z: zoom });
  drawSoon();
}

function fitAll() {
  change({ z: 0, cx: -1, cy: -1 });
  drawSoon();
}

/** Move a pixel into view if it is not visible. */
function bringIntoView(x, y) {
  const pane = looking.panes[0];
  if (!pane || state.z <= 0) return;
  const [px, py] = pane.place(x + 0.5, y + 0.5), edge = Math.min(24, pane.width / 4);
  if (px < edge || py < edge || px > pane.width - edge || py > pane.height - edge) lookAt(x + 0.5, y + 0.5);
}

let drawing = 0;
function drawSoon() {
  if (!drawing) drawing = requestAnimationFrame(drawNow);
}

function drawNow() {
  drawing = 0;
  if (!looking.record || !looking.data) return;
  for (const pane of looking.panes) pane.draw();
  const { scale } = looking.panes[0];
  byId("zoom").textContent = `${state.z > 0 ? "" : "fit "}${scale >= 10 ? scale.toFixed(0) : scale.toFixed(1)}\u00d7`;
  showPixel();
}

// Pointer, wheel and touch events on an image.

/** The wheel zooms, dragging pans or moves the wipe, a click pins a pixel; the pixel below the pointer is inspected. */
function listenTo(pane) {
  const { canvas } = pane, touches = new Map();
  let moved = 0, wiping = false;
  const spot = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const rowAt = (event) => looking.record?.row(...pane.film(...spot(event)).map(Math.floor)) ?? -1;
  canvas.addEventListener("wheel", (event) => {
    if (!looking.record) return;
    event.preventDefault();
    zoomBy(2 ** (-event.deltaY / 250), pane, pane.film(...spot(event)));
  }, { passive: false });
  canvas.addEventListener("pointerdown", (event) => {
    if (!looking.record) return;
    canvas.setPointerCapture(event.pointerId);
    touches.set(event.pointerId, spot(event));
    moved = 0;
    wiping = pane.which === "wipe" && Math.abs(spot(event)[0] - pane.width * state.w) < 12;
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!looking.record) return;
    const now = spot(event), before = touches.get(event.pointerId);
    if (!before) {
      looking.under = rowAt(event);
      return drawSoon();
    }
    const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    moved += Math.abs(dx) + Math.abs(dy);
    if (touches.size === 2) pinch(pane, touches, event.pointerId, now);
    else if (wiping) wipeTo(now[0] / pane.width);
    else if (moved > 3) {
      const [cx, cy] = center();
      lookAt(cx - dx / pane.scale, cy - dy / pane.scale, pane.scale);
    }
    touches.set(event.pointerId, now);
  });
  canvas.addEventListener("pointerup", (event) => {
    touches.delete(event.pointerId);
    const row = rowAt(event);
    if (moved <= 3 && !wiping && row >= 0) pin(row);
  });
  canvas.addEventListener("pointercancel", (event) => touches.delete(event.pointerId));
  canvas.addEventListener("pointerleave", () => {
    looking.under = -1;
    drawSoon();
  });
  canvas.addEventListener("dblclick", (event) => zoomBy(4, pane, pane.film(...spot(event))));
}

/** Two fingers: zoom by their distance, about the finger that does not move. */
function pinch(pane, touches, moving, now) {
  const [[, other]] = [...touches].filter(([id]) => id !== moving);
  const apart = ([x, y]) => Math.hypot(x - other[0], y - other[1]) || 1;
  zoomBy(apart(now) / apart(touches.get(moving)), pane, pane.film(...other));
}

function wipeTo(share) {
  change({ w: Math.min(1, Math.max(0, share)) });
  drawSoon();
}

function pin(row) {
  const [x, y] = looking.record.pixel(row);
  change({ x, y });
  bringIntoView(x, y);
  drawSoon();
}

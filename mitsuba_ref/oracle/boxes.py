"""A tree of boxes, traversed in float64 with a margin, so that no box that a ray passes is missed."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

BRANCHING_FACTOR = 32  # boxes in a box of the next level
RAYS_PER_BATCH = 1 << 10
MAX_RAY_BOX_PAIRS = 1 << 20  # tested together; beyond, a batch is split
GROUPS_PER_CHUNK = 1 << 10  # groups tested at once: temporary arrays of 256 kB stay in a cache
LARGEST_MORTON_CELL = 2**10 - 1

# A ray enters and leaves a box at t = (bound - o) (1 / d). Its four roundings are below 4 u (|bound| + |o|) / |d|,
# u = 2^-53, and a margin of at least 2^-44 moves it by more. Denormal numbers are rounded by 2^-1075 instead, which the
# smallest margin covers. Coordinates and d are scaled by 1/4, so that no difference overflows. Where 1 / d overflows,
# the axis bounds nothing; where only t does, it is infinite, and indeed beyond all finite limits.
COORDINATE_SCALE = 0.25
SMALLEST_MARGIN = 2.0**-1060


class BoxCrossings(NamedTuple):
    """Pairs of a ray and a box; no point of the ray within the box has a t below near."""

    batch: slice  # the rays that were tested
    ray: np.ndarray  # (m,)
    box: np.ndarray  # (m,)
    near: np.ndarray  # (m,) -inf if unknown


class BoxRays(NamedTuple):
    """Rays in columns, with the margin of their origins."""

    low: np.ndarray  # (3, n) origin for lower bounds of boxes
    high: np.ndarray  # (3, n) origin for upper bounds
    over_d: np.ndarray  # (3, n)
    t_min: np.ndarray  # (n,)
    t_max: np.ndarray  # (n,)


class BoxLevel(NamedTuple):
    """Boxes in groups; the last group is filled with copies of its last box."""

    low: np.ndarray  # (3, groups, BRANCHING_FACTOR)
    high: np.ndarray
    boxes: int  # without copies


class BoxTree:
    """A tree of boxes in Morton order."""

    def __init__(self, low: np.ndarray, high: np.ndarray, margin: float, numbers: np.ndarray | None = None) -> None:
        """low, high: corners (n, 3); any ray passes a box without finite bounds.

        margin: growth of boxes, as a fraction of |o| + their farthest corner. numbers: (n,) of the boxes, if not 0 to
        n - 1.
        """
        bounded = np.isfinite(low).all(axis=1) & np.isfinite(high).all(axis=1)
        boxed = np.flatnonzero(bounded)
        ends = (low, high) if bounded.all() else (low[boxed], high[boxed])
        order = np.append(boxed[morton_order(*ends)], np.flatnonzero(~bounded))
        self.margin, self.order = margin, order if numbers is None else numbers[order]
        whole = np.append(order, np.repeat(order[-1:], -len(order) % BRANCHING_FACTOR))
        below, above = (COORDINATE_SCALE * corner[whole].T for corner in (low, high))
        pad = margin * np.maximum(np.abs(below), np.abs(above)).max(axis=0) + SMALLEST_MARGIN
        self.levels = box_levels(below - pad, above + pad, len(order))

    def crossings(
        self, o: np.ndarray, d: np.ndarray, t_min: np.ndarray | float = 0.0, t_max: np.ndarray | float = np.inf
    ) -> Iterator[BoxCrossings]:
        """All boxes that contain a point of the ray o + t d (n, 3) with t_min < t <= t_max, and some more.

        In batches; each ray is in one batch only, and batches are in the order of the rays.
        """
        starts, ends = (np.broadcast_to(np.asarray(t, np.float64), len(o)) for t in (t_min, t_max))
        waiting = [slice(at, min(at + RAYS_PER_BATCH, len(o))) for at in range(0, len(o), RAYS_PER_BATCH)][::-1]
        while waiting:
            batch = waiting.pop()
            found = self._crossings(batch, box_rays(o[batch], d[batch], starts[batch], ends[batch], self.margin))
            if found is None:
                middle = (batch.start + batch.stop) // 2
                waiting += [slice(middle, batch.stop), slice(batch.start, middle)]
            else:
                yield found

    def _crossings(self, batch: slice, rays: BoxRays) -> BoxCrossings | None:
        """None if several rays pass too many boxes to be processed together."""
        count = len(rays.t_min)
        ray, box, near = np.arange(count if self.levels else 0), np.zeros(count if self.levels else 0, np.int64), None
        for level in reversed(self.levels):
            if len(ray) * BRANCHING_FACTOR > MAX_RAY_BOX_PAIRS and count > 1:
                return None
            ray, box, near = passed_members(rays, ray, box, level)
        near = np.zeros(0) if near is None else np.where(np.isfinite(near), near - SMALLEST_MARGIN, -np.inf)
        return BoxCrossings(batch, ray + batch.start, self.order[box], near)


def box_rays(o: np.ndarray, d: np.ndarray, t_min: np.ndarray, t_max: np.ndarray, margin: float) -> BoxRays:
    """Rays o + t d (n, 3), t_min < t <= t_max, for boxes grown by the same margin."""
    columns = COORDINATE_SCALE * o.T
    pad = margin * np.abs(columns).max(axis=0) + SMALLEST_MARGIN
    with np.errstate(divide="ignore", over="ignore"):
        over_d = 1.0 / (COORDINATE_SCALE * d.T)
    over_d[np.isinf(over_d) & (d.T != 0.0)] = np.nan
    return BoxRays(columns + pad, columns - pad, over_d, t_min - SMALLEST_MARGIN, t_max + SMALLEST_MARGIN)


def passed_members(
    rays: BoxRays, ray: np.ndarray, group: np.ndarray, level: BoxLevel
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(ray, box, near) of the boxes in group[i] that ray[i] passes, for each i."""
    found = [(ray[:0], group[:0], np.zeros(0))]
    with np.errstate(over="ignore", invalid="ignore"):
        for start in range(0, len(ray), GROUPS_PER_CHUNK):
            some, of = (a[start : start + GROUPS_PER_CHUNK] for a in (ray, group))
            near, far = np.array(-np.inf), np.array(np.inf)
            for axis in range(3):  # one by one: a maximum over an axis of three takes ten times as long
                over_d = rays.over_d[axis, some, None]
                a = (level.low[axis, of] - rays.low[axis, some, None]) * over_d
                b = (level.high[axis, of] - rays.high[axis, some, None]) * over_d
                near, far = np.fmax(near, np.minimum(a, b)), np.fmin(far, np.maximum(a, b))  # NaN bounds nothing
            missed = (near > far) | (far < rays.t_min[some, None]) | (near > rays.t_max[some, None])
            i, member = np.nonzero(~missed)
            found.append((some[i], of[i] * BRANCHING_FACTOR + member, near[i, member]))
    ray, boxes, near = (np.concatenate(column) for column in zip(*found, strict=True))
    there = boxes < level.boxes
    return ray[there], boxes[there], near[there]


def box_levels(low: np.ndarray, high: np.ndarray, boxes: int) -> list[BoxLevel]:
    """Levels of a box tree: boxes (3, n) in whole groups, the boxes of these groups, and so on up to one group."""
    groups, levels = (3, -1, BRANCHING_FACTOR), []
    while boxes:
        level = BoxLevel(low.reshape(groups), high.reshape(groups), boxes)
        levels.append(level)
        boxes = level.low.shape[1] if level.low.shape[1] > 1 else 0
        missing = (0, 0), (0, -boxes % BRANCHING_FACTOR)
        low = np.pad(level.low.min(axis=2), missing, mode="edge")
        high = np.pad(level.high.max(axis=2), missing, mode="edge")
    return levels


def morton_order(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Morton order of finite boxes: by the interleaved bits of their centres."""
    if not len(low):
        return np.zeros(0, np.int64)
    centre = 0.5 * low + 0.5 * high
    start = centre.min(axis=0)
    size = np.maximum(0.5 * centre.max(axis=0) - 0.5 * start, np.finfo(np.float64).tiny)
    cell = (np.clip((0.5 * centre - 0.5 * start) / size, 0.0, 1.0) * LARGEST_MORTON_CELL).astype(np.int64)
    return np.argsort(sum(spread_bits(cell[:, axis]) << axis for axis in range(3)), kind="stable")


def spread_bits(x: np.ndarray) -> np.ndarray:
    """The ten bits of each number, with two zeros between them."""
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        x = (x | (x << shift)) & mask
    return x

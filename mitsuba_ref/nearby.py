"""Which primitives a ray may have to do with, without asking any of them twice.

Shares no code with the trees it judges. It may give too many; a primitive that any ray within rounding meets is
never left out, unless it is a sliver thinner than MARGIN.
"""

from collections.abc import Iterator

import numpy as np

from mitsuba_ref.meeting import KU

# How much boxes are grown, as a share of |o| + their farthest corner. The bound of an edge function, divided by the
# length of the edge, is 6 to 8 KU of that (shapes/triangles.py); of a quadric 2 to 4. What lies beyond is at best
# possible (a certain one is passed by the ray itself), and leaving it out takes an excuse away from both sides.
MARGIN = 16 * KU

GROUP = 32  # primitives in a box of the first pass
TESTS_AT_ONCE = 1 << 21  # rays times boxes; 50 MB a temporary array


class Nearby:
    """Boxes of primitives (n, 3), (n, 3), grouped by where they are."""

    def __init__(self, low: np.ndarray, high: np.ndarray):
        self.low, self.high = low, high
        self.order = along_a_curve(low, high)
        starts = np.arange(0, len(low), GROUP)
        self.group_low = np.minimum.reduceat(low[self.order], starts) if len(low) else low
        self.group_high = np.maximum.reduceat(high[self.order], starts) if len(low) else high

    def pairs(self, o: np.ndarray, d: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """(ray, primitive) for rays (n, 3), (n, 3), in pieces; each ray is in one piece only."""
        step = max(1, TESTS_AT_ONCE // max(1, len(self.group_low), 64 * GROUP))
        for start in range(0, len(o), step):
            rows = np.arange(start, min(start + step, len(o)))
            yield self._pairs_of(rows, o[rows], d[rows])

    def _pairs_of(self, rows: np.ndarray, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        near = meets_box(o[:, None], d[:, None], self.group_low[None], self.group_high[None])
        ray, group = np.nonzero(near)
        place = (group[:, None] * GROUP + np.arange(GROUP)).ravel()
        ray = np.repeat(ray, GROUP)
        inside = place < len(self.order)
        ray, prim = ray[inside], self.order[place[inside]]
        near = meets_box(o[ray], d[ray], self.low[prim], self.high[prim])
        return rows[ray[near]], prim[near]


def meets_box(o: np.ndarray, d: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Whether rays o + t d, t >= 0, pass a box grown by MARGIN; everything broadcasts over (..., 3)."""
    reach = np.abs(o).max(axis=-1) + np.maximum(np.abs(low), np.abs(high)).max(axis=-1)
    grown = (MARGIN * reach)[..., None]
    slope = np.where(d == 0.0, np.finfo(np.float64).tiny, d)
    with np.errstate(over="ignore", invalid="ignore"):
        a, b = (low - grown - o) / slope, (high + grown - o) / slope
    near, far = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
    met: np.ndarray = ~(near > far) & ~(far < 0.0)
    return met


def along_a_curve(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The boxes in Morton order of their centres, those without bounds last."""
    bounded = np.isfinite(low).all(axis=1) & np.isfinite(high).all(axis=1)
    centre = 0.5 * low[bounded] + 0.5 * high[bounded]
    code = np.full(len(low), np.iinfo(np.int64).max)
    if len(centre):
        start, size = centre.min(axis=0), np.ptp(centre, axis=0)
        cell = ((centre - start) / np.where(size > 0.0, size, 1.0) * 1023.0).astype(np.int64)
        code[bounded] = sum(spread_bits(cell[:, axis]) << axis for axis in range(3))
    return np.argsort(code, kind="stable")


def spread_bits(x: np.ndarray) -> np.ndarray:
    """The ten bits of each number, with two zeros between them."""
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        x = (x | (x << shift)) & mask
    return x

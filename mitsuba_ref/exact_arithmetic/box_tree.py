"""Which boxes a ray passes, in float64 but never too few."""

from typing import NamedTuple

import numpy as np

GROUP = 32  # boxes in a box of the next level
RAYS_AT_ONCE = 256  # each of which passes some hundred boxes
PAIRS_AT_ONCE = 1 << 19  # of a ray and a box; 100 MB of temporary arrays
CURVE_BITS = 10  # of each coordinate along the curve

# A box begins and ends at t = (bound - o) / d, a rounded difference over d: off by (1 + u)^2 - 1 < 3 u of itself,
# u = 2^-53, and by 2^-1075 where it is denormal. Forming and subtracting the pad rounds three times more: 8 u and
# 2^-1060 leave room for that. Where the difference or t overflows, inf - inf is NaN, which bounds nothing.
PAD_RTOL = 8 * 2.0**-53
PAD_ATOL = 2.0**-1060


class Passed(NamedTuple):
    """Pairs of a ray and a box; no point of the ray within the box has a t below near."""

    ray: np.ndarray  # (m,)
    box: np.ndarray  # (m,)
    near: np.ndarray  # (m,)


class Rays(NamedTuple):
    """Columns, for fast sums over the three coordinates."""

    o: np.ndarray  # (3, n)
    d: np.ndarray  # (3, n)
    t_min: np.ndarray  # (n,)
    t_max: np.ndarray  # (n,)


class BoxTree:
    """Boxes in groups, and groups in groups; nothing a ray passes is left out."""

    def __init__(self, low: np.ndarray, high: np.ndarray) -> None:
        """low, high: (n, 3), finite."""
        self.order = along_a_curve(low, high)
        self.levels = [(low[self.order].T.copy(), high[self.order].T.copy())]
        while self.levels[-1][0].shape[1] > GROUP:
            below, above = self.levels[-1]
            starts = np.arange(0, below.shape[1], GROUP)
            self.levels.append(
                (np.minimum.reduceat(below, starts, axis=1), np.maximum.reduceat(above, starts, axis=1))
            )

    def passed(self, rays: Rays) -> Passed | None:
        """Every box that holds a point of ray i with t_min[i] < t <= t_max[i], and some more.

        None for several rays that pass too many boxes to look at together.
        """
        count = rays.o.shape[1]
        top = self.levels[-1][0].shape[1]
        ray, place = np.repeat(np.arange(count), top), np.tile(np.arange(top), count)
        near = np.zeros(0)
        for depth in range(len(self.levels) - 1, -1, -1):
            low, high = self.levels[depth]
            met, near = slabs(rays, ray, low[:, place], high[:, place])
            ray, place, near = ray[met], place[met], near[met]
            if depth:
                if len(ray) * GROUP > PAIRS_AT_ONCE and count > 1:
                    return None
                ray, place = within(ray, place, self.levels[depth - 1][0].shape[1])
        return Passed(ray, self.order[place], near)


def within(ray: np.ndarray, group: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Each pair of a ray and a group, as pairs with the members of the group."""
    place = (group[:, None] * GROUP + np.arange(GROUP)).ravel()
    ray = np.repeat(ray, GROUP)
    there = place < count
    return ray[there], place[there]


def slabs(rays: Rays, ray: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(whether ray[i] passes box i, the least t at which it may); boxes low, high are (3, m)."""
    o, d = rays.o[:, ray], rays.d[:, ray]
    with np.errstate(all="ignore"):
        forward = d > 0.0
        entry = (np.where(forward, low, high) - o) / d
        leave = (np.where(forward, high, low) - o) / d
        entry -= PAD_RTOL * np.abs(entry) + PAD_ATOL
        leave += PAD_RTOL * np.abs(leave) + PAD_ATOL
    beside = ((d == 0.0) & ((o < low) | (o > high))).any(axis=0)  # there, entry and leave are NaN
    near = np.fmax.reduce(entry, axis=0, initial=-np.inf)
    far = np.fmin.reduce(leave, axis=0, initial=np.inf)
    met: np.ndarray = ~(beside | (near > far) | (far <= rays.t_min[ray]) | (near > rays.t_max[ray]))
    return met, near


def along_a_curve(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """An order in which neighbours are close to each other: by the bits of their centres, taken in turn."""
    if not len(low):
        return np.zeros(0, np.int64)
    centre = 0.5 * low + 0.5 * high
    start = centre.min(axis=0)
    size = np.maximum(0.5 * centre.max(axis=0) - 0.5 * start, np.finfo(np.float64).tiny)
    cell = (np.clip((0.5 * centre - 0.5 * start) / size, 0.0, 1.0) * (2**CURVE_BITS - 1)).astype(np.int64)
    code = np.zeros(len(low), np.int64)
    for bit in range(CURVE_BITS):
        for axis in range(3):
            code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")

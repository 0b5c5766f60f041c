"""Ways to aim rays at trouble. Each gives origins and directions, (count, 3) both."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from mitsuba_ref.fuzz.setting import Rng, Setting, directions, nudged
from mitsuba_ref.fuzz.spots import Targets

OD = tuple[np.ndarray, np.ndarray]
Aim = Callable[[Rng, Targets, Setting, int], OD]


class Shots(NamedTuple):
    """Rays as they are cast: points o + t d with t_min < t <= t_max."""

    o: np.ndarray  # (n, 3) float64
    d: np.ndarray  # (n, 3) float64, of any length
    t_min: np.ndarray  # (n,)
    t_max: np.ndarray  # (n,)

    def taken(self, rows: np.ndarray | slice) -> "Shots":
        return Shots(*(a[rows] for a in self))


def at_places(rng: Rng, targets: Targets, setting: Setting, count: int) -> OD:
    """From anywhere around, at corners, edges, rims and beside them."""
    spots = targets.spots(rng, targets.pick(rng, count))
    distance = setting.size * 10.0 ** rng.uniform(-2.0, 1.5, (count, 1))
    o = setting.snapped(spots.p + distance * directions(rng, count))
    return o, spots.p - o


def tangents(rng: Rng, targets: Targets, setting: Setting, count: int) -> OD:
    """Along the surface, from a place that they then touch."""
    spots = targets.spots(rng, targets.pick(rng, count))
    steps = rng.integers(1, 5, (count, 1)) * rng.choice([-1.0, 1.0, 0.25, -16.0], (count, 1))
    return spots.p - steps * spots.along, np.copysign(1.0, steps) * spots.along


def through_two(rng: Rng, targets: Targets, setting: Setting, count: int) -> OD:
    """Through two places of one primitive: in the plane of what is flat, a chord of what is round."""
    picks = targets.pick(rng, count)
    p, q = targets.spots(rng, picks).p, targets.spots(rng, picks).p
    return p - rng.integers(0, 4, (count, 1)) * (q - p), q - p


def between_two(rng: Rng, targets: Targets, setting: Setting, count: int) -> OD:
    """From a place on one primitive to a place on another."""
    p, q = (targets.spots(rng, targets.pick(rng, count)).p for _ in range(2))
    return p, q - p


def from_places(rng: Rng, targets: Targets, setting: Setting, count: int) -> OD:
    """From a place on a surface: anywhere, along it, or straight out and in."""
    spots = targets.spots(rng, targets.pick(rng, count))
    ways = [directions(rng, count), spots.along, spots.n, -spots.n]
    return spots.p, np.choose(rng.integers(4, size=(count, 1)), ways)


def along_axes(rng: Rng, targets: Targets, setting: Setting, count: int) -> OD:
    """One component of d is not zero, or two; the zeros have either sign; o shares coordinates with places."""
    spots = targets.spots(rng, targets.pick(rng, count))
    zeros = rng.choice([0.0, -0.0], (count, 3))
    d = np.where(rng.random((count, 3)) < 0.2, rng.choice([1.0, -1.0, 2.0], (count, 3)), zeros)
    d[np.arange(count), rng.integers(3, size=count)] = rng.choice([-1.0, 1.0], count)
    steps = setting.size * rng.integers(0, 5, (count, 1))
    return spots.p - steps * d, d


def anywhere(rng: Rng, targets: Targets, setting: Setting, count: int) -> OD:
    """From around the middle, at any place or past everything."""
    spots = targets.spots(rng, targets.pick(rng, count), "inside")
    o = np.array(setting.middle) + 2.0 * setting.size * rng.normal(size=(count, 3))
    astray = setting.size * rng.choice([0.0, 1.0], (count, 1)) * rng.normal(size=(count, 3))
    return o, spots.p + astray - o


def from_afar(rng: Rng, targets: Targets, setting: Setting, count: int) -> OD:
    """From 1e2 to 1e8 sizes away."""
    spots = targets.spots(rng, targets.pick(rng, count))
    distance = setting.size * 10.0 ** rng.uniform(2.0, 8.0, (count, 1))
    o = spots.p + distance * directions(rng, count)
    return o, spots.p - o


ALL: tuple[Aim, ...] = (
    at_places,
    tangents,
    through_two,
    between_two,
    from_places,
    along_axes,
    anywhere,
    from_afar,
)

NUDGED = 0.25  # share of rays moved by a few units in the last place
STRANGE = 0.1  # share of rays whose direction gets an unusual length or an almost-zero component
ALMOST_ZERO = (-0.0, 0.0, 5e-324, -5e-324, 1e-310, -2.3e-308, 1e-200, 1e-30)


def aimed(rng: Rng, targets: Targets, setting: Setting, count: int, aims: Sequence[Aim] = ALL) -> Shots:
    """`count` rays, each by one of the aims; all finite, none without a direction."""
    which = rng.integers(len(aims), size=count)
    o, d = np.zeros((count, 3)), np.zeros((count, 3))
    for i, aim in enumerate(aims):
        rows = np.flatnonzero(which == i)
        if len(rows):
            with np.errstate(all="ignore"):
                o[rows], d[rows] = aim(rng, targets, setting, len(rows))
    o, d = _nudged_some(rng, o, d)
    d = _strange_some(rng, d)
    return real(Shots(o, d, np.zeros(count), np.full(count, np.inf)))


def _nudged_some(rng: Rng, o: np.ndarray, d: np.ndarray) -> OD:
    count = len(o)
    move_o = (rng.random((count, 1)) < NUDGED / 2) & (rng.random((count, 3)) < 0.5)
    move_d = (rng.random((count, 1)) < NUDGED / 2) & (rng.random((count, 3)) < 0.5)
    return np.where(move_o, nudged(rng, o), o), np.where(move_d, nudged(rng, d), d)


def _strange_some(rng: Rng, d: np.ndarray) -> np.ndarray:
    count = len(d)
    length = np.where(rng.random((count, 1)) < STRANGE, 10.0 ** rng.uniform(-30.0, 30.0, (count, 1)), 1.0)
    with np.errstate(all="ignore"):
        d = d * length
    thin = (rng.random((count, 1)) < STRANGE) & (np.arange(3) == rng.integers(3, size=(count, 1)))
    return np.where(thin, rng.choice(ALMOST_ZERO, (count, 1)), d)


def real(shots: Shots) -> Shots:
    """The same, with what is no ray replaced by one along z."""
    bad = ~np.isfinite(shots.o).all(axis=1) | ~np.isfinite(shots.d).all(axis=1) | ~shots.d.any(axis=1)
    o, d = shots.o.copy(), shots.d.copy()
    o[bad], d[bad] = (0.0, 0.0, -3.0), (0.0, -0.0, 1.0)
    return shots._replace(o=np.ascontiguousarray(o), d=np.ascontiguousarray(d))

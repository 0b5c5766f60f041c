"""Adversarial rays: aimed at corners, edges, rims and tangents of the primitives of a scene."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from caster.geometry.packing import Packed, primitive_count
from mitsuba_ref.shapes import kind_of
from mitsuba_ref.shapes.targets import LATTICE_STEPS, POINT_KINDS, Rng, SurfacePoints, random_directions


@dataclass(frozen=True)
class Frame:
    """Frame of a random scene: size, position, condition of transforms, lattice or not."""

    size: float = 1.0  # of a shape, scene units; a power of two on the lattice
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    condition: float = 1.0  # upper bound, of the linear parts of to_world
    lattice: bool = False

    def on_lattice(self, points: np.ndarray) -> np.ndarray:
        """The points, rounded to the lattice if this frame has one."""
        if not self.lattice:
            return points
        step = self.size / LATTICE_STEPS
        return step * np.round(points / step)


def perturbed_by_ulps(rng: Rng, numbers: np.ndarray, ulps: int = 2) -> np.ndarray:
    """Move each number by up to this many units in the last place."""
    steps = rng.integers(-ulps, ulps + 1, np.shape(numbers))
    out = np.array(numbers, np.float64)
    with np.errstate(over="ignore", under="ignore"):
        for step in range(1, ulps + 1):
            beyond = np.nextafter(out, np.copysign(np.inf, steps))
            out = np.where(np.abs(steps) >= step, beyond, out)
    return out


class PrimitivePicks(NamedTuple):
    """Primitives, one a row: k counts within the shape."""

    shape: np.ndarray  # (m,)
    k: np.ndarray  # (m,)


class Targets:
    """Primitives of a packed scene to aim at."""

    def __init__(self, packed: Packed) -> None:
        self.parts = packed.parts
        self.counts = np.array([primitive_count(part) for part in packed.parts])

    def pick(self, rng: Rng, count: int) -> PrimitivePicks:
        """Random primitives: a random shape, then one of its primitives."""
        shape = rng.choice(np.flatnonzero(self.counts), count)
        return PrimitivePicks(shape, rng.integers(self.counts[shape]))

    def points(self, rng: Rng, picks: PrimitivePicks, sort: str | None = None) -> SurfacePoints:
        """A point on each of these primitives, of one kind of POINT_KINDS or of a random one."""
        sorts = np.full(len(picks.k), sort) if sort else rng.choice(POINT_KINDS, len(picks.k), p=(0.3, 0.3, 0.2, 0.2))
        out = SurfacePoints(*np.zeros((3, len(picks.k), 3)))
        for shape in np.unique(picks.shape):
            for each in np.unique(sorts):
                rows = np.flatnonzero((picks.shape == shape) & (sorts == each))
                if len(rows):
                    part = self.parts[shape]
                    found = kind_of(part).surface_points(part, picks.k[rows], rng, str(each))
                    for all_rows, some in zip(out, found, strict=True):
                        all_rows[rows] = some
        return out


# Aims: functions of (random generator, targets, frame, count) that give origins and directions, (count, 3) both.

OriginsAndDirections = tuple[np.ndarray, np.ndarray]
Aim = Callable[[Rng, Targets, Frame, int], OriginsAndDirections]


class RayBatch(NamedTuple):
    """Rays o + t d, t_min < t <= t_max."""

    o: np.ndarray  # (n, 3) float64
    d: np.ndarray  # (n, 3) float64, of any length
    t_min: np.ndarray  # (n,)
    t_max: np.ndarray  # (n,)

    def taken(self, rows: np.ndarray | slice) -> "RayBatch":
        return RayBatch(*(a[rows] for a in self))


def from_decades(low: float, high: float) -> Aim:
    """At corners, edges, rims and beside them, from 10^low to 10^high sizes away in any direction."""

    def aim(rng: Rng, targets: Targets, frame: Frame, count: int) -> OriginsAndDirections:
        at = targets.points(rng, targets.pick(rng, count))
        distance = frame.size * 10.0 ** rng.uniform(low, high, (count, 1))
        o = frame.on_lattice(at.p + distance * random_directions(rng, count))
        return o, at.p - o

    return aim


at_features, from_afar = from_decades(-2.0, 1.5), from_decades(2.0, 8.0)


def tangents(rng: Rng, targets: Targets, frame: Frame, count: int) -> OriginsAndDirections:
    """Along a tangent of the surface, from some steps before its point."""
    at = targets.points(rng, targets.pick(rng, count))
    steps = rng.integers(1, 5, (count, 1)) * rng.choice([-1.0, 1.0, 0.25, -16.0], (count, 1))
    return at.p - steps * at.along, np.copysign(1.0, steps) * at.along


def through_two_points(rng: Rng, targets: Targets, frame: Frame, count: int) -> OriginsAndDirections:
    """Through two points of one primitive: in the plane of a flat one, a chord of a curved one."""
    picks = targets.pick(rng, count)
    p, q = targets.points(rng, picks).p, targets.points(rng, picks).p
    return p - rng.integers(0, 4, (count, 1)) * (q - p), q - p


def between_two_points(rng: Rng, targets: Targets, frame: Frame, count: int) -> OriginsAndDirections:
    """From a point on one primitive to a point on another."""
    p, q = (targets.points(rng, targets.pick(rng, count)).p for _ in range(2))
    return p, q - p


def from_surface(rng: Rng, targets: Targets, frame: Frame, count: int) -> OriginsAndDirections:
    """From a point on a surface in any direction, along a tangent or along the normal, out or in."""
    at = targets.points(rng, targets.pick(rng, count))
    ways = [random_directions(rng, count), at.along, at.n, -at.n]
    return at.p, np.choose(rng.integers(4, size=(count, 1)), ways)


def along_axes(rng: Rng, targets: Targets, frame: Frame, count: int) -> OriginsAndDirections:
    """Mostly one component of d is not zero; zeros have either sign; o shares coordinates with surfaces."""
    at = targets.points(rng, targets.pick(rng, count))
    zeros = rng.choice([0.0, -0.0], (count, 3))
    d = np.where(rng.random((count, 3)) < 0.2, rng.choice([1.0, -1.0, 2.0], (count, 3)), zeros)
    d[np.arange(count), rng.integers(3, size=count)] = rng.choice([-1.0, 1.0], count)
    steps = frame.size * rng.integers(0, 5, (count, 1))
    return at.p - steps * d, d


def anywhere(rng: Rng, targets: Targets, frame: Frame, count: int) -> OriginsAndDirections:
    """From around the centre, towards a surface or past it."""
    at = targets.points(rng, targets.pick(rng, count), "inside")
    o = np.array(frame.center) + 2.0 * frame.size * rng.normal(size=(count, 3))
    astray = frame.size * rng.choice([0.0, 1.0], (count, 1)) * rng.normal(size=(count, 3))
    return o, at.p + astray - o


def of_any_length(aim: Aim, exponent: int) -> Aim:
    """The same aim with directions scaled by 2^-exponent to 2^exponent."""

    def longer(rng: Rng, targets: Targets, frame: Frame, count: int) -> OriginsAndDirections:
        o, d = aim(rng, targets, frame, count)
        return o, np.ldexp(d, rng.integers(-exponent, exponent + 1, (count, 1)))

    return longer


ALL_AIMS: tuple[Aim, ...] = (
    at_features,
    tangents,
    through_two_points,
    between_two_points,
    from_surface,
    along_axes,
    anywhere,
    from_afar,
)

PERTURBED_SHARE = 0.25  # share of rays moved by a few units in the last place
UNUSUAL_SHARE = 0.1  # share of rays whose direction gets an unusual length or an almost-zero component
DENORMAL_AND_TINY = (-0.0, 0.0, 5e-324, -5e-324, 1e-310, -2.3e-308, 1e-200, 1e-30)


def aimed_rays(rng: Rng, targets: Targets, frame: Frame, count: int, aims: Sequence[Aim] = ALL_AIMS) -> RayBatch:
    """`count` rays, each by one of the aims; all finite, none without a direction."""
    which = rng.integers(len(aims), size=count)
    o, d = np.zeros((count, 3)), np.zeros((count, 3))
    for i, aim in enumerate(aims):
        rows = np.flatnonzero(which == i)
        if len(rows):
            with np.errstate(all="ignore"):
                o[rows], d[rows] = aim(rng, targets, frame, len(rows))
    o, d = _perturb_some(rng, o, d)
    d = _make_some_unusual(rng, d)
    return finite_rays(RayBatch(o, d, np.zeros(count), np.full(count, np.inf)))


def _perturb_some(rng: Rng, o: np.ndarray, d: np.ndarray) -> OriginsAndDirections:
    count = len(o)
    move_o = (rng.random((count, 1)) < PERTURBED_SHARE / 2) & (rng.random((count, 3)) < 0.5)
    move_d = (rng.random((count, 1)) < PERTURBED_SHARE / 2) & (rng.random((count, 3)) < 0.5)
    return np.where(move_o, perturbed_by_ulps(rng, o), o), np.where(move_d, perturbed_by_ulps(rng, d), d)


def _make_some_unusual(rng: Rng, d: np.ndarray) -> np.ndarray:
    count = len(d)
    length = np.where(rng.random((count, 1)) < UNUSUAL_SHARE, 10.0 ** rng.uniform(-30.0, 30.0, (count, 1)), 1.0)
    with np.errstate(all="ignore"):
        d = d * length
    thin = (rng.random((count, 1)) < UNUSUAL_SHARE) & (np.arange(3) == rng.integers(3, size=(count, 1)))
    return np.where(thin, rng.choice(DENORMAL_AND_TINY, (count, 1)), d)


def finite_rays(rays: RayBatch) -> RayBatch:
    """The same rays; those that are not finite or have no direction are replaced by one along z."""
    bad = ~np.isfinite(rays.o).all(axis=1) | ~np.isfinite(rays.d).all(axis=1) | ~rays.d.any(axis=1)
    o, d = rays.o.copy(), rays.d.copy()
    o[bad], d[bad] = (0.0, 0.0, -3.0), (0.0, -0.0, 1.0)
    return rays._replace(o=np.ascontiguousarray(o), d=np.ascontiguousarray(d))

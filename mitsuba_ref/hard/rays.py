"""Adversarial rays: aimed at corners, edges, rims and tangents of the primitives of a scene."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from caster.geometry.packing import Packed, primitive_count
from mitsuba_ref.error_model.intersections import Array, Rays
from mitsuba_ref.shapes import kind_of
from mitsuba_ref.shapes.targets import LATTICE_STEPS, POINT_KINDS, Rng, SurfacePoints, random_directions


class Frame(NamedTuple):
    """Frame of a random scene: size, position, condition of transforms, lattice or not."""

    size: float = 1.0  # of a shape, scene units; a power of two on the lattice
    center: Array = np.zeros(3)
    condition: float = 1.0  # upper bound, of the linear parts of to_world
    lattice: bool = False

    def on_lattice(self, points: Array) -> Array:
        """The points, rounded to the lattice if this frame has one."""
        if not self.lattice:
            return points
        step = self.size / LATTICE_STEPS
        return step * np.round(points / step)

    def placed(self, points: Array) -> Array:
        """Points around the origin, in sizes, moved into the frame."""
        return self.on_lattice(self.center + self.size * points)

    def near(self, rng: Rng, spread: float, *count: int) -> Array:
        """(*count, 3) random points around the centre. spread: their standard deviation, in sizes."""
        return self.center + spread * self.size * rng.normal(size=(*count, 3))


AT_ORIGIN = Frame()


def perturbed_by_ulps(rng: Rng, numbers: Array, ulps: int = 2) -> Array:
    """Move each number by up to this many units in the last place."""
    steps = rng.integers(-ulps, ulps + 1, numbers.shape)
    with np.errstate(over="ignore", under="ignore"):
        for step in range(1, ulps + 1):
            numbers = np.where(np.abs(steps) >= step, np.nextafter(numbers, np.copysign(np.inf, steps)), numbers)
    return numbers


POINT_SHARES = (0.3, 0.3, 0.2, 0.2)  # of the POINT_KINDS
SIZE_SAMPLES = 64  # points from which the size of a scene is estimated


PrimitivePicks = tuple[Array, Array]  # (m,) shapes, (m,) primitives, counted within each


class Targets:
    """Primitives of a packed scene to aim at, and the random numbers to do it with."""

    def __init__(self, packed: Packed, rng: Rng, frame: Frame = AT_ORIGIN) -> None:
        self.packed, self.rng, self.frame = packed, rng, frame
        self.counts = np.array([primitive_count(part) for part in packed.parts])

    def fit_frame(self) -> None:
        """Set the frame by points of the scene; medians, so that a single far primitive does not count."""
        p = self.points(SIZE_SAMPLES, "inside").p
        center = np.median(p, axis=0)
        size = float(np.median(np.abs(p - center).max(axis=1)))
        self.frame = Frame(size if size > 0.0 else 1.0, center)

    def pick(self, count: int) -> PrimitivePicks:
        """Random primitives: a random shape, then one of its primitives."""
        shape = self.rng.choice(np.flatnonzero(self.counts), count)
        return shape, self.rng.integers(self.counts[shape])

    def points(self, picks: PrimitivePicks | int, sort: str | None = None) -> SurfacePoints:
        """A point on each of these primitives, or on so many random ones. sort: one of POINT_KINDS; None: random."""
        shapes, k = self.pick(picks) if isinstance(picks, int) else picks
        sorts = np.full(len(k), sort) if sort else self.rng.choice(POINT_KINDS, len(k), p=POINT_SHARES)
        out = SurfacePoints(*np.zeros((3, len(k), 3)))
        for shape in np.unique(shapes):
            part = self.packed.parts[shape]
            for each in np.unique(sorts):
                rows = np.flatnonzero((shapes == shape) & (sorts == each))
                if len(rows):
                    found = kind_of(part).surface_points(part, k[rows], self.rng, str(each))
                    for all_rows, some in zip(out, found, strict=True):
                        all_rows[rows] = some
        return out


# Aims: functions of (targets, count) that give origins and directions, (count, 3) both.

OriginsAndDirections = tuple[Array, Array]
Aim = Callable[[Targets, int], OriginsAndDirections]


def endless(o: Array, d: Array) -> Rays:
    """Rays without limits."""
    return Rays(o, d, np.zeros(len(o)), np.full(len(o), np.inf))


def from_decades(low: float, high: float) -> Aim:
    """At corners, edges, rims and beside them, from 10^low to 10^high sizes away in any direction."""

    def aim(targets: Targets, count: int) -> OriginsAndDirections:
        at, frame = targets.points(count), targets.frame
        distance = frame.size * 10.0 ** targets.rng.uniform(low, high, (count, 1))
        o = frame.on_lattice(at.p + distance * random_directions(targets.rng, count))
        return o, at.p - o

    return aim


at_features, from_afar = from_decades(-2.0, 1.5), from_decades(2.0, 8.0)


def tangents(targets: Targets, count: int) -> OriginsAndDirections:
    """Along a tangent of the surface, from some steps before its point."""
    at, rng = targets.points(count), targets.rng
    steps = rng.integers(1, 5, (count, 1)) * rng.choice([-1.0, 1.0, 0.25, -16.0], (count, 1))
    return at.p - steps * at.along, np.copysign(1.0, steps) * at.along


def through_two_points(targets: Targets, count: int) -> OriginsAndDirections:
    """Through two points of one primitive: in the plane of a flat one, a chord of a curved one."""
    picks = targets.pick(count)
    p, q = targets.points(picks).p, targets.points(picks).p
    return p - targets.rng.integers(0, 4, (count, 1)) * (q - p), q - p


def between_two_points(targets: Targets, count: int) -> OriginsAndDirections:
    """From a point on one primitive to a point on another."""
    p, q = targets.points(count).p, targets.points(count).p
    return p, q - p


def from_surface(targets: Targets, count: int) -> OriginsAndDirections:
    """From a point on a surface in any direction, along a tangent or along the normal, out or in."""
    at = targets.points(count)
    ways = [random_directions(targets.rng, count), at.along, at.n, -at.n]
    return at.p, np.choose(targets.rng.integers(4, size=(count, 1)), ways)


def along_axes(targets: Targets, count: int) -> OriginsAndDirections:
    """Mostly one component of d is not zero; zeros have either sign; o shares coordinates with surfaces."""
    at, rng = targets.points(count), targets.rng
    zeros = rng.choice([0.0, -0.0], (count, 3))
    d = np.where(rng.random((count, 3)) < 0.2, rng.choice([1.0, -1.0, 2.0], (count, 3)), zeros)
    d[np.arange(count), rng.integers(3, size=count)] = rng.choice([-1.0, 1.0], count)
    return at.p - targets.frame.size * rng.integers(0, 5, (count, 1)) * d, d


def anywhere(targets: Targets, count: int) -> OriginsAndDirections:
    """From around the centre, towards a surface or past it."""
    p, rng, frame = targets.points(count, "inside").p, targets.rng, targets.frame
    o = frame.near(rng, 2.0, count)
    astray = frame.size * rng.choice([0.0, 1.0], (count, 1)) * rng.normal(size=(count, 3))
    return o, p + astray - o


def of_any_length(aim: Aim, exponent: int) -> Aim:
    """The same aim with directions scaled by 2^-exponent to 2^exponent."""

    def longer(targets: Targets, count: int) -> OriginsAndDirections:
        o, d = aim(targets, count)
        return o, np.ldexp(d, targets.rng.integers(-exponent, exponent + 1, (count, 1)))

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


@np.errstate(all="ignore")
def aimed_rays(targets: Targets, count: int, aims: Sequence[Aim]) -> Rays:
    """`count` rays, each by one of the aims; some perturbed or unusual; all finite, none without a direction."""
    rng = targets.rng
    which = rng.integers(len(aims), size=count)
    o, d = np.zeros((count, 3)), np.zeros((count, 3))
    for i, aim in enumerate(aims):
        rows = np.flatnonzero(which == i)
        if len(rows):
            o[rows], d[rows] = aim(targets, len(rows))
    moved = [(rng.random((count, 1)) < PERTURBED_SHARE / 2) & (rng.random((count, 3)) < 0.5) for _ in "od"]
    o, d = (np.where(some, perturbed_by_ulps(rng, a), a) for some, a in zip(moved, (o, d), strict=True))
    d = d * np.where(rng.random((count, 1)) < UNUSUAL_SHARE, 10.0 ** rng.uniform(-30.0, 30.0, (count, 1)), 1.0)
    thin = (rng.random((count, 1)) < UNUSUAL_SHARE) & (np.arange(3) == rng.integers(3, size=(count, 1)))
    d = np.where(thin, rng.choice(DENORMAL_AND_TINY, (count, 1)), d)
    bad = ~np.isfinite(o).all(axis=1) | ~np.isfinite(d).all(axis=1) | ~d.any(axis=1)
    o[bad], d[bad] = (0.0, 0.0, -3.0), (0.0, -0.0, 1.0)
    return endless(o, d)

"""Places on primitives where rays are likely to be judged wrongly: corners, edges, rims, and any others."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from caster.description.errors import SceneError
from caster.geometry.packing import Packed, primitive_count
from mitsuba_ref.fuzz.settings import Rng, Setting, perturbed_by_ulps, random_directions

POINT_KINDS = ("corner", "edge", "beside", "inside")  # beside: just outside of an edge or a rim
BESIDE_DECADES = (-16.0, -2.0)  # decades of how far outside, in sizes of the primitive


class SurfacePoints(NamedTuple):
    """One row a place. Computed in float64, so on the primitive up to rounding; exactly so on the lattice."""

    p: np.ndarray  # (m, 3)
    along: np.ndarray  # (m, 3) a direction within the surface there: of the edge, the rim or a tangent
    n: np.ndarray  # (m, 3) across the surface, of any length


UnitPoints = tuple[np.ndarray, np.ndarray, np.ndarray]  # p, along, n of a shape at the origin
SurfaceSampler = Callable[[Any, np.ndarray, Rng, str], SurfacePoints]


class PrimitivePicks(NamedTuple):
    """Primitives, one a row: k counts within the shape."""

    shape: np.ndarray  # (m,)
    k: np.ndarray  # (m,)


class Targets:
    """The primitives of a packed scene, as something to aim at."""

    def __init__(self, packed: Packed) -> None:
        self.parts = packed.parts
        self.counts = np.array([primitive_count(part) for part in packed.parts])

    def pick(self, rng: Rng, count: int) -> PrimitivePicks:
        """Any shape, then any of its primitives."""
        shape = rng.choice(np.flatnonzero(self.counts), count)
        return PrimitivePicks(shape, rng.integers(self.counts[shape]))

    def spots(self, rng: Rng, picks: PrimitivePicks, sort: str | None = None) -> SurfacePoints:
        """A place on each of them, of this sort or of any."""
        sorts = (
            np.full(len(picks.k), sort)
            if sort
            else rng.choice(POINT_KINDS, len(picks.k), p=(0.3, 0.3, 0.2, 0.2))
        )
        out = SurfacePoints(*np.zeros((3, len(picks.k), 3)))
        for shape in np.unique(picks.shape):
            for each in np.unique(sorts):
                rows = np.flatnonzero((picks.shape == shape) & (sorts == each))
                if len(rows):
                    part = self.parts[shape]
                    found = place_of(part)(part, picks.k[rows], rng, str(each))
                    for all_rows, some in zip(out, found, strict=True):
                        all_rows[rows] = some
        return out


def place_of(part: Any) -> SurfaceSampler:
    name = type(part).__name__
    if name not in SURFACE_SAMPLERS:
        raise SceneError(
            f"fuzz: no places to aim at on {name}: add a line {name!r}: (a function of the packed arrays, "
            "primitive numbers (m,), a random generator and a sort that gives Spots) to PLACES in "
            "mitsuba_ref/fuzz/aims.py"
        )
    return SURFACE_SAMPLERS[name]


def on_triangles(prims: Any, k: np.ndarray, rng: Rng, sort: str) -> SurfacePoints:
    corners = prims.vertices[prims.faces[k]]
    corners = np.take_along_axis(
        corners, rng.permuted(np.tile(np.arange(3), (len(k), 1)), axis=1)[..., None], 1
    )
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    share = random_fractions(rng, len(k))
    along = np.where(rng.random((len(k), 1)) < 0.7, b - a, (b - a) + share * (c - a))
    n = np.cross(b - a, c - a)
    if sort == "corner":
        return SurfacePoints(a, along, n)
    if sort == "edge":
        return SurfacePoints(a + share * (b - a), b - a, n)
    if sort == "beside":
        out = 10.0 ** rng.uniform(*BESIDE_DECADES, (len(k), 1))
        return SurfacePoints(a + share * (b - a) - out * (c - a), b - a, n)
    return SurfacePoints(a + 0.5 * share * (b - a) + 0.5 * random_fractions(rng, len(k)) * (c - a), along, n)


def on_planes(prims: Any, k: np.ndarray, rng: Rng, sort: str) -> SurfacePoints:
    n = prims.normal[k]
    side = np.eye(3)[np.argmin(np.abs(n), axis=1)]
    u, v = np.cross(n, side), np.cross(n, np.cross(n, side))
    if sort == "corner":
        return SurfacePoints(prims.point[k], u, n)
    at = random_fractions(rng, len(k)) * u + random_fractions(rng, len(k)) * v
    return SurfacePoints(prims.point[k] + at, np.where(rng.random((len(k), 1)) < 0.5, u, v), n)


def on_spheres(prims: Any, k: np.ndarray, rng: Rng, sort: str) -> SurfacePoints:
    p, along, n = unit_sphere_points(rng, len(k), sort)
    r = prims.radius[k][:, None]
    return SurfacePoints(prims.center[k] + r * p, r * along, n)


def on_ellipsoids(prims: Any, k: np.ndarray, rng: Rng, sort: str) -> SurfacePoints:
    return to_world_points(prims, k, unit_sphere_points(rng, len(k), sort))


def on_cylinders(prims: Any, k: np.ndarray, rng: Rng, sort: str) -> SurfacePoints:
    return to_world_points(prims, k, unit_cylinder_points(rng, len(k), sort))


def on_disks(prims: Any, k: np.ndarray, rng: Rng, sort: str) -> SurfacePoints:
    return to_world_points(prims, k, unit_disk_points(rng, len(k), sort))


def to_world_points(prims: Any, k: np.ndarray, unit: UnitPoints) -> SurfacePoints:
    """A unit shape's places under p -> center + to_world p."""
    p, along, n = unit
    to_world, to_object = prims.to_world[k], prims.to_object[k]
    moved = prims.center[k] + np.einsum("ijk,ik->ij", to_world, p)
    across = np.einsum("ikj,ik->ij", to_object, n)
    return SurfacePoints(
        moved, np.einsum("ijk,ik->ij", to_world, along), across / np.abs(across).max(initial=1e-300)
    )


def unit_sphere_points(rng: Rng, count: int, sort: str) -> UnitPoints:
    c, s = unit_circle_points(rng, count)
    turned = rng.permuted(np.column_stack([c, s, np.zeros(count)]), axis=1)
    any_way = rng.normal(size=(count, 3))
    any_way /= np.linalg.norm(any_way, axis=1, keepdims=True)
    u = np.where((sort == "corner") | (rng.random((count, 1)) < 0.3), turned, any_way)
    across = np.cross(u, np.eye(3)[np.argmin(np.abs(u), axis=1)])
    return pushed_outside(rng, u, sort), across, u


def unit_cylinder_points(rng: Rng, count: int, sort: str) -> UnitPoints:
    c, s = unit_circle_points(rng, count)
    zero, one = np.zeros(count), np.ones(count)
    z = (
        rng.integers(0, 2, count).astype(float)
        if sort in ("corner", "beside")
        else random_fractions(rng, count)[:, 0]
    )
    if sort == "beside":
        z += 10.0 ** rng.uniform(*BESIDE_DECADES, count) * np.where(z > 0.0, 1.0, -1.0)
    around, upright = np.column_stack([-s, c, zero]), np.column_stack([zero, zero, one])
    along = np.where(rng.random((count, 1)) < 0.5, around, upright)
    return np.column_stack([c, s, z]), along, np.column_stack([c, s, zero])


def unit_disk_points(rng: Rng, count: int, sort: str) -> UnitPoints:
    c, s = unit_circle_points(rng, count)
    zero = np.zeros(count)
    rim, around = np.column_stack([c, s, zero]), np.column_stack([-s, c, zero])
    share = random_fractions(rng, count) if sort == "inside" else np.ones((count, 1))
    along = np.where(rng.random((count, 1)) < 0.5, around, rim)
    return share * pushed_outside(rng, rim, sort), along, np.tile([0.0, 0.0, 1.0], (count, 1))


def pushed_outside(rng: Rng, p: np.ndarray, sort: str) -> np.ndarray:
    return p * (1.0 + 10.0 ** rng.uniform(*BESIDE_DECADES, (len(p), 1))) if sort == "beside" else p


def unit_circle_points(rng: Rng, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of the unit circle: on an axis, (3, 4) / 5 up to one rounding, or any."""
    angle = 2.0 * np.pi * rng.random(count)
    c = np.choose(rng.integers(3, size=count), [np.ones(count), np.full(count, 0.6), np.cos(angle)])
    s = np.choose((c == 1.0) + 2 * (c == 0.6), [np.sin(angle), np.zeros(count), np.full(count, 0.8)])
    swap = rng.random(count) < 0.5
    c, s = np.where(swap, s, c), np.where(swap, c, s)
    return c * rng.choice([-1.0, 1.0], count), s * rng.choice([-1.0, 1.0], count)


def random_fractions(rng: Rng, count: int) -> np.ndarray:
    """(count, 1) of 0 to 1; half of them eighths, which leave lattice points on the lattice."""
    eighths = rng.integers(0, 9, (count, 1)) / 8.0
    return np.where(rng.random((count, 1)) < 0.5, eighths, rng.random((count, 1)))


SURFACE_SAMPLERS: dict[str, SurfaceSampler] = {
    "Triangles": on_triangles,
    "Planes": on_planes,
    "Spheres": on_spheres,
    "Ellipsoids": on_ellipsoids,
    "Cylinders": on_cylinders,
    "Disks": on_disks,
}


# Ways to aim rays at trouble. Each gives origins and directions, (count, 3) both.


OriginsAndDirections = tuple[np.ndarray, np.ndarray]
Aim = Callable[[Rng, Targets, Setting, int], OriginsAndDirections]


class Shots(NamedTuple):
    """Rays as they are cast: points o + t d with t_min < t <= t_max."""

    o: np.ndarray  # (n, 3) float64
    d: np.ndarray  # (n, 3) float64, of any length
    t_min: np.ndarray  # (n,)
    t_max: np.ndarray  # (n,)

    def taken(self, rows: np.ndarray | slice) -> "Shots":
        return Shots(*(a[rows] for a in self))


def at_features(rng: Rng, targets: Targets, setting: Setting, count: int) -> OriginsAndDirections:
    """From anywhere around, at corners, edges, rims and beside them."""
    spots = targets.spots(rng, targets.pick(rng, count))
    distance = setting.size * 10.0 ** rng.uniform(-2.0, 1.5, (count, 1))
    o = setting.on_lattice(spots.p + distance * random_directions(rng, count))
    return o, spots.p - o


def tangents(rng: Rng, targets: Targets, setting: Setting, count: int) -> OriginsAndDirections:
    """Along the surface, from a place that they then touch."""
    spots = targets.spots(rng, targets.pick(rng, count))
    steps = rng.integers(1, 5, (count, 1)) * rng.choice([-1.0, 1.0, 0.25, -16.0], (count, 1))
    return spots.p - steps * spots.along, np.copysign(1.0, steps) * spots.along


def through_two_points(rng: Rng, targets: Targets, setting: Setting, count: int) -> OriginsAndDirections:
    """Through two places of one primitive: in the plane of what is flat, a chord of what is round."""
    picks = targets.pick(rng, count)
    p, q = targets.spots(rng, picks).p, targets.spots(rng, picks).p
    return p - rng.integers(0, 4, (count, 1)) * (q - p), q - p


def between_two_points(rng: Rng, targets: Targets, setting: Setting, count: int) -> OriginsAndDirections:
    """From a place on one primitive to a place on another."""
    p, q = (targets.spots(rng, targets.pick(rng, count)).p for _ in range(2))
    return p, q - p


def from_surface(rng: Rng, targets: Targets, setting: Setting, count: int) -> OriginsAndDirections:
    """From a place on a surface: anywhere, along it, or straight out and in."""
    spots = targets.spots(rng, targets.pick(rng, count))
    ways = [random_directions(rng, count), spots.along, spots.n, -spots.n]
    return spots.p, np.choose(rng.integers(4, size=(count, 1)), ways)


def along_axes(rng: Rng, targets: Targets, setting: Setting, count: int) -> OriginsAndDirections:
    """One component of d is not zero, or two; the zeros have either sign; o shares coordinates with places."""
    spots = targets.spots(rng, targets.pick(rng, count))
    zeros = rng.choice([0.0, -0.0], (count, 3))
    d = np.where(rng.random((count, 3)) < 0.2, rng.choice([1.0, -1.0, 2.0], (count, 3)), zeros)
    d[np.arange(count), rng.integers(3, size=count)] = rng.choice([-1.0, 1.0], count)
    steps = setting.size * rng.integers(0, 5, (count, 1))
    return spots.p - steps * d, d


def anywhere(rng: Rng, targets: Targets, setting: Setting, count: int) -> OriginsAndDirections:
    """From around the middle, at any place or past everything."""
    spots = targets.spots(rng, targets.pick(rng, count), "inside")
    o = np.array(setting.middle) + 2.0 * setting.size * rng.normal(size=(count, 3))
    astray = setting.size * rng.choice([0.0, 1.0], (count, 1)) * rng.normal(size=(count, 3))
    return o, spots.p + astray - o


def from_afar(rng: Rng, targets: Targets, setting: Setting, count: int) -> OriginsAndDirections:
    """From 1e2 to 1e8 sizes away."""
    spots = targets.spots(rng, targets.pick(rng, count))
    distance = setting.size * 10.0 ** rng.uniform(2.0, 8.0, (count, 1))
    o = spots.p + distance * random_directions(rng, count)
    return o, spots.p - o


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


def aimed_rays(
    rng: Rng, targets: Targets, setting: Setting, count: int, aims: Sequence[Aim] = ALL_AIMS
) -> Shots:
    """`count` rays, each by one of the aims; all finite, none without a direction."""
    which = rng.integers(len(aims), size=count)
    o, d = np.zeros((count, 3)), np.zeros((count, 3))
    for i, aim in enumerate(aims):
        rows = np.flatnonzero(which == i)
        if len(rows):
            with np.errstate(all="ignore"):
                o[rows], d[rows] = aim(rng, targets, setting, len(rows))
    o, d = _perturb_some(rng, o, d)
    d = _make_some_unusual(rng, d)
    return finite_rays(Shots(o, d, np.zeros(count), np.full(count, np.inf)))


def _perturb_some(rng: Rng, o: np.ndarray, d: np.ndarray) -> OriginsAndDirections:
    count = len(o)
    move_o = (rng.random((count, 1)) < PERTURBED_SHARE / 2) & (rng.random((count, 3)) < 0.5)
    move_d = (rng.random((count, 1)) < PERTURBED_SHARE / 2) & (rng.random((count, 3)) < 0.5)
    return np.where(move_o, perturbed_by_ulps(rng, o), o), np.where(move_d, perturbed_by_ulps(rng, d), d)


def _make_some_unusual(rng: Rng, d: np.ndarray) -> np.ndarray:
    count = len(d)
    length = np.where(
        rng.random((count, 1)) < UNUSUAL_SHARE, 10.0 ** rng.uniform(-30.0, 30.0, (count, 1)), 1.0
    )
    with np.errstate(all="ignore"):
        d = d * length
    thin = (rng.random((count, 1)) < UNUSUAL_SHARE) & (np.arange(3) == rng.integers(3, size=(count, 1)))
    return np.where(thin, rng.choice(DENORMAL_AND_TINY, (count, 1)), d)


def finite_rays(shots: Shots) -> Shots:
    """The same, with what is no ray replaced by one along z."""
    bad = ~np.isfinite(shots.o).all(axis=1) | ~np.isfinite(shots.d).all(axis=1) | ~shots.d.any(axis=1)
    o, d = shots.o.copy(), shots.d.copy()
    o[bad], d[bad] = (0.0, 0.0, -3.0), (0.0, -0.0, 1.0)
    return shots._replace(o=np.ascontiguousarray(o), d=np.ascontiguousarray(d))

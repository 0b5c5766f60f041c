"""Primitives of every kind and a ray for each, aimed where it is hard to tell what happens.

Whole coordinates make edges, rims, tangents and ends exact: with columns that are multiples of 5, the point
(3/5, 4/5) of the unit circle has whole coordinates, too, and so has the tangent there. Everything is scaled by powers
of two, so that it stays exact from 1e-300 to 1e300, or by other numbers, which round it to somewhere beside.
"""

from fractions import Fraction
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from caster.geometry.packing import Kind, Packed, Triangles, primitive_count
from caster.shapes.cylinder import Cylinders
from caster.shapes.disk import Disks
from caster.shapes.linear_curve import RoundSegments
from caster.shapes.plane import Planes
from caster.shapes.sphere import Ellipsoids, OuterEllipsoids, Spheres
from mitsuba_ref.oracle.exact_numbers import Root

Rng = np.random.Generator
Aims = tuple[Any, np.ndarray, np.ndarray]  # primitives, a point on each or beside it, and directions

# (scale of space, scale of d): exact ones, those that round, the range of float64, and denormal numbers
SCALES = {
    "whole": (1.0, 1.0),
    "rounded": (0.1, 1 / 3),
    "tiny": (2.0**-1000, 2.0**-900),
    "huge": (2.0**990, 2.0**-900),
    "large": (2.0**51, 2.0**-3),  # most faces are just small enough to count
    "denormal": (2.0**-1074, 1.0),
    "tiny, rounded": (1e-300, 1e-10),
    "huge, rounded": (1e290, 1e290),
    "slow": (1.0, 2.0**-1074),
}


class Aimed(NamedTuple):
    """n primitives of one kind, and ray i for primitive i."""

    prims: Any
    o: np.ndarray  # (n, 3)
    d: np.ndarray  # (n, 3)


def root_bracket(root: Root, bits: int) -> tuple[Fraction, Fraction]:
    """Bounds of a root, 2^(e - bits) / s apart or equal."""
    low, high = (Fraction(n, root.s) * Fraction(2) ** (root.e - bits) for n in root.numerators(bits))
    return low, high


def packed(*arrays: Any) -> Packed:
    """Arrays of primitives as a scene, each kind one shape, numbered in their order."""
    counts = [primitive_count(prims) for prims in arrays]
    first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    kinds = [Kind(a, np.arange(i, j, dtype=np.int32)) for a, i, j in zip(arrays, first, first[1:], strict=False)]
    return Packed(tuple(kinds), arrays, first)


def whole(rng: Rng, *shape: int, size: int = 99) -> np.ndarray:
    return rng.integers(-size, size + 1, shape).astype(np.float64)


def triangles(vertices: np.ndarray, faces: np.ndarray | None = None) -> Triangles:
    """Vertices (n, 3, 3), three by three; or (v, 3) with faces (n, 3)."""
    v = np.ascontiguousarray(vertices.reshape(-1, 3), np.float64)
    f = np.arange(len(v), dtype=np.int32).reshape(-1, 3) if faces is None else faces.astype(np.int32)
    flat = np.zeros(len(f), bool)
    return Triangles(v, f, np.zeros_like(v), np.zeros((len(v), 2)), flat, flat)


def affine(kind: Any, center: np.ndarray, to_world: np.ndarray) -> Any:
    """`to_object` is NaN: the oracle has to do without."""
    return kind(center, to_world, np.full(to_world.shape, np.nan))


def aim(kind: str, scale: str, seed: int, n: int) -> Aimed:
    """A third of the rays at exact places, a third beside them by a rounding or a step, a third anywhere near."""
    rng = np.random.default_rng([seed, KINDS.index(kind), list(SCALES).index(scale)])
    prims, p, d = AIMS[kind](rng, n)
    steps = rng.choice([0.0, 0.0, 1.0, -1.0, 0.5, 2.0, 7.0], n)  # 0: the ray starts where it meets
    d = np.where((d == 0.0).all(axis=1)[:, None], [[0.0, 0.0, 1.0]], d)
    o = p - steps[:, None] * d
    aside = rng.choice([0, 0, 1, 2], n)
    d = np.where(aside[:, None] == 1, d + whole(rng, n, 3, size=3), d)
    o = np.where(aside[:, None] == 2, o * (1.0 + rng.choice([-1, 1], (n, 3)) * 2.0**-50), o)
    d = np.where((d == 0.0).all(axis=1)[:, None], [[0.0, 1.0, 0.0]], d)
    space, speed = SCALES[scale]
    signs = rng.choice([1.0, -1.0], (n, 3))
    d = np.where(d == 0.0, 0.0 * signs, d * speed)  # zeros of both signs
    return Aimed(scaled(prims, space), o * space, d)


def scaled(prims: Any, by: float) -> Any:
    """Every length times `by`; normals keep theirs."""
    lengths = {"vertices", "center", "radius", "to_world", "point", "start", "end"}
    return prims._replace(**{name: getattr(prims, name) * by for name in lengths & set(prims._fields)})


def aim_at_triangles(rng: Rng, n: int) -> Aims:
    """Corners, midpoints of edges, inside; directions anywhere, along an axis, or in the triangle's plane."""
    v = 4.0 * whole(rng, n, 3, 3)
    flat = rng.random(n) < 0.3
    v[flat, :, 2] = v[flat, :1, 2]  # in a plane z = constant: its box has no height
    thin = rng.random(n) < 0.1
    v[thin, 2] = 2.0 * v[thin, 1] - v[thin, 0]  # no area
    weights = np.array([[4, 0, 0], [0, 2, 2], [2, 0, 2], [1, 1, 2], [3, 1, 0], [5, 0, -1]])[rng.integers(0, 6, n)] / 4.0
    p = np.einsum("ij,ijk->ik", weights, v)
    d = directions(rng, n, v[:, 1] - v[:, 0])
    return triangles(v), p, d


def directions(rng: Rng, n: int, along: np.ndarray) -> np.ndarray:
    """Whole directions: anywhere, along an axis, or `along`."""
    d = whole(rng, n, 3)
    axes = np.eye(3)[rng.integers(0, 3, n)] * rng.choice([-4.0, 4.0], (n, 1))
    sort = rng.choice(3, n, p=[0.6, 0.25, 0.15])[:, None]
    return np.where(sort == 0, d, np.where(sort == 1, axes, along))


def aim_at_planes(rng: Rng, n: int) -> Aims:
    normal, point = whole(rng, n, 3, size=9), whole(rng, n, 3)
    normal[(normal == 0.0).all(axis=1)] = 1.0
    across = np.cross(normal, whole(rng, n, 3, size=9))
    return Planes(normal, point), point + across, directions(rng, n, across)


CIRCLE = np.array([[3, 4, 0], [-4, 3, 0], [5, 0, 0], [0, -5, 0], [-3, -4, 0], [3, 0, 0], [0, 0, 0], [4, 4, 0]]) / 5.0
AROUND = np.array([[-4, 3, 0], [-3, -4, 0], [0, 5, 0], [5, 0, 0], [4, -3, 0], [0, 5, 0], [5, 5, 0], [4, -4, 0]]) / 5.0
BALL = np.array([[3, 4, 0], [0, 3, 4], [5, 0, 0], [0, 0, -5], [-4, 0, 3], [3, 0, 0], [0, 0, 0], [4, 4, 0]]) / 5.0
BESIDE = np.array([[-4, 3, 5], [5, 4, -3], [0, 5, 5], [5, 5, 0], [3, 5, 4], [0, 5, 5], [5, 5, 5], [4, -4, 5]]) / 5.0


def unit_aims(rng: Rng, n: int, p: np.ndarray, tangent: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points of the unit shape (the last three are inside or beside it), and directions: tangent or anywhere."""
    place = rng.integers(0, len(p), n)
    touching = rng.random((n, 1)) < 0.4
    return p[place], np.where(touching, tangent[place] * rng.choice([-1.0, 1.0, 2.0], (n, 1)), whole(rng, n, 3, size=4))


def aim_at_spheres(rng: Rng, n: int) -> Aims:
    center, radius = whole(rng, n, 3), 5.0 * rng.integers(1, 30, n).astype(np.float64)
    radius[rng.random(n) < 0.02] = 0.0
    q, d = unit_aims(rng, n, BALL, BESIDE)
    turn = np.zeros((n, 3, 3))
    return Spheres(center, radius, turn), np.rint(center + radius[:, None] * q), np.rint(5.0 * d)


def matrices(rng: Rng, n: int) -> np.ndarray:
    """Sheared, mirrored, round; and some that have no inverse."""
    m = 5.0 * whole(rng, n, 3, 3, size=9)
    m[rng.random(n) < 0.3] *= np.eye(3)
    flat = rng.random(n) < 0.05
    m[flat, :, 2] = m[flat, :, 1]
    return m


def through(m: np.ndarray, q: np.ndarray) -> np.ndarray:
    return np.rint(np.einsum("ijk,ik->ij", m, q))


def aim_at_images(kind: Any, points: np.ndarray, tangents: np.ndarray, rng: Rng, n: int) -> Aims:
    """Images of the unit shape of a kind."""
    center, m = whole(rng, n, 3), matrices(rng, n)
    q, d = unit_aims(rng, n, points, tangents)
    return affine(kind, center, m), center + through(m, q), through(m, d)


def aim_at_segments(rng: Rng, n: int) -> Aims:
    """Half of them are cylinders with caps along z; at the ends, half-way and on the axis, tangent or anywhere."""
    start, axis, radius = 5.0 * whole(rng, n, 3), 2.0 * whole(rng, n, 3), 5.0 * rng.integers(1, 20, (n, 2))
    straight = rng.random(n) < 0.5
    axis[straight, :2], radius[straight, 1] = 0.0, radius[straight, 0]
    axis[rng.random(n) < 0.05] = 0.0
    q, d = unit_aims(rng, n, CIRCLE, AROUND)
    share = rng.choice([0.0, 0.5, 1.0, 1.6], (n, 1))
    d = np.where(rng.random((n, 1)) < 0.1, 0.0, d) + rng.choice([0.0, 0.0, 1.0], (n, 1)) * [0.0, 0.0, 1.0]
    p = start + share * axis + ((1.0 - share) * radius[:, :1] + share * radius[:, 1:]) * q
    return RoundSegments(start, start + axis, radius.astype(np.float64)), np.rint(p), np.rint(5.0 * d)


def aim_at_tubes(rng: Rng, n: int) -> Aims:
    """On the wall at, between and beyond the ends; directions across, along a tangent, parallel to the axis."""
    center, m = whole(rng, n, 3), matrices(rng, n)
    q, d = unit_aims(rng, n, CIRCLE, AROUND)
    up = np.array([0.0, 0.0, 1.0])
    q = q + rng.choice([0.0, 1.0, 0.4, 1.2], (n, 1)) * up
    d = np.where(rng.random((n, 1)) < 0.1, 0.0, d) + rng.choice([0.0, 1.0, -0.2], (n, 1)) * up
    return affine(Cylinders, center, m), center + through(m, q), through(m, d)


AIMS = {
    "Triangles": aim_at_triangles,
    "Planes": aim_at_planes,
    "Spheres": aim_at_spheres,
    "Ellipsoids": partial(aim_at_images, Ellipsoids, BALL, BESIDE),
    "Cylinders": aim_at_tubes,
    "Disks": partial(aim_at_images, Disks, CIRCLE, AROUND),
    "OuterEllipsoids": partial(aim_at_images, OuterEllipsoids, BALL, BESIDE),
    "RoundSegments": aim_at_segments,
}
KINDS = tuple(AIMS)

"""Predicted intersections with error bounds, the interface of error models, and groups of pixels by rounding."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.oracle.interface import ExactKind

Array = np.ndarray  # shape and dtype are in the comment or docstring beside it

# Decorators of functions in which infinite numbers are answers like others, which comparisons sort out.
without_float_warnings = np.errstate(all="ignore")  # where a NaN is an answer: of a miss, or of no answer
without_overflow_warnings = np.errstate(over="ignore", divide="ignore")  # a NaN is a fault

# Embree drops a triangle with a coordinate beyond this, silently.
LARGEST_COORDINATE = 1.844e18


class Rays(NamedTuple):
    """n rays o + t d, t_min < t <= t_max."""

    o: Array  # (n, 3) float64
    d: Array  # (n, 3) of any length
    t_min: Array  # (n,)
    t_max: Array  # (n,) negative: no ray

    def take(self, rows: Array | list[int] | slice) -> "Rays":
        """Some of them, by index, mask or slice."""
        return Rays(*(a[rows] for a in self))


class Intersections(NamedTuple):
    """One root of each of m pairs of a ray and a primitive. Errors bound how far off the judged side may be."""

    t: Array  # (m,) parameter of the intersection, lengths of d
    t_error: Array  # (m,) inf where float32 cannot resolve it
    n: Array  # (m, 3) geometric normal
    n_error: Array  # (m,)
    sh_n: Array  # (m, 3) shading normal
    sh_error: Array  # (m,)
    possible: Array  # (m,) bool: some perturbation within the bound hits
    certain: Array  # (m,) bool: every perturbation within the bound hits
    p_error: Array  # (m,) bound on the position, scene units
    uv: Array  # (m, 3) uv as a point of the kind's UvSpace
    uv_error: Array  # (m,) bound on that point
    edge: Array  # (m, 6) end points of the only edge that leaves a triangle in doubt, else NaN
    side: Array  # (m,) on which side of that edge the triangle lies, -1 or 1; 0 without such an edge

    def take(self, rows: Array) -> "Intersections":
        """Some of them, by index or mask."""
        return Intersections(*(a[rows] for a in self))


def without_edges(
    t: Array,
    t_error: Array,
    n: Array,
    n_error: Array,
    possible: Array,
    certain: Array,
    p_error: Array,
    uv: Array,
    uv_error: Array,
) -> Intersections:
    """Intersections of a kind whose normals are not interpolated, and which has no edges in common with others."""
    edge, side = np.full((len(t), 6), np.nan), np.zeros(len(t))
    return Intersections(t, t_error, n, n_error, n, n_error, possible, certain, p_error, uv, uv_error, edge, side)


def no_intersections(count: int) -> Intersections:
    """Placeholder rows for misses: all numbers inf."""
    far, rows, none = np.full(count, np.inf), np.full((count, 3), np.inf), np.zeros(count, bool)
    return Intersections(*(a.copy() for a in without_edges(far, far, rows, far, none, none, far, rows, far)))


def joined(parts: Sequence[Intersections]) -> Intersections:
    """One after the other."""
    return Intersections(*map(np.concatenate, zip(*parts, strict=True)))


# (prims, k (m,), o (m, 3), d (m, 3), ku) -> for each root, the intersections of primitive k[i] with ray i.
# ku is K times the unit round-off of the judged side: KU for the reference, KU_OURS for a float64 caster.
IntersectFunction = Callable[[Any, Array, Array, Array, float], tuple[Intersections, ...]]


# (prims, k (m,), uv (m, 2)) -> (m, 3); NaN for uv that the surface does not have
UvPoints = Callable[[Any, Array, Array], Array]


def plain_uv(_prims: Any, _k: Array, uv: Array) -> Array:
    """(u, v, 0): uv without seams or poles are compared as they are."""
    return stacked_columns(*uv.T, np.zeros(len(uv)))


class UvSpace(NamedTuple):
    """Maps uv of one kind to points, so that seams and poles are no jumps.

    u = 0 and u = 1 on a circle become one point of the plane, and at the pole of a sphere all u become one point. So
    one bound on the distance holds everywhere, and uv that mean the same place differ by nothing.
    """

    subject: UvPoints = plain_uv
    reference: UvPoints | None = plain_uv  # for the reference's uv; None: they belong to a stand-in, and mean nothing
    loaded: UvPoints | None = None  # for the reference's uv of a Mitsuba file's shape; None: the same


class ErrorModel(NamedTuple):
    """The error model of one kind of primitive."""

    intersect: IntersectFunction  # the reference's primitive, or its stand-in
    exact: ExactKind  # exact arithmetic on our own primitive, for the oracle; boxes, also of stand-ins
    intersect_ours: IntersectFunction | None = None  # our own primitive, where the reference's is a stand-in
    uv: UvSpace = UvSpace()
    # (prims) -> (m,): the largest distance at which a ray may pass each primitive and be a hit of the reference by its
    # rounding, over |o| + the distance of the primitive from the origin; None: no more than BOX_MARGIN
    growth: Callable[[Any], Array] | None = None
    intersect_foreign: IntersectFunction | None = None  # bounds for any usual algorithm; None: those above


# Large arrays of vectors (m, 3) are stored column by column: over three neighbours, sums take NumPy four times as long
# and `np.cross` twelve times.


def by_columns(rows: Array) -> Array:
    """The array in column-major order."""
    return np.asfortranarray(rows)


def stacked_columns(*columns: Array) -> Array:
    """(m, c) array of columns (m,), in column-major order."""
    return np.stack(columns).T


def rounded(a: Array) -> Array:
    """The nearest float32 values, as float64."""
    return a.astype(np.float32).astype(np.float64)


def any_of_columns(rows: Array) -> Array:
    """(m,) bool: any of a few columns (m, c) is true. `any` over such an axis takes ten times as long."""
    return np.logical_or.reduce([*rows.T])


def largest_of_columns(rows: Array) -> Array:
    """(m,) largest of a few numbers >= 0 in each row (m, c); 0 without columns, NaN if any is NaN."""
    return np.maximum.reduce([np.zeros(len(rows)), *rows.T])


def cross(a: Array, b: Array) -> Array:
    """Row-wise cross product, with the bits of `np.cross`."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return stacked_columns(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


def ceil_log2(x: Array) -> Array:
    """The smallest integer k with x <= 2^k, for finite x > 0; exact, where a logarithm would be rounded."""
    fraction, exponent = np.frexp(x)
    return np.asarray(exponent - (fraction == 0.5), np.int64)


def dot(a: Array, b: Array) -> Array:
    """Row-wise dot product."""
    return np.einsum("ij,ij->i", a, b)


def norm(a: Array) -> Array:
    """Length of each row."""
    return np.sqrt(dot(a, a))


def unit(a: Array) -> Array:
    """Each row divided by its length; zero rows stay."""
    length = norm(a)
    return a / np.where(length > 0.0, length, 1.0)[:, None]


def cross_permanent(a: Array, b: Array) -> Array:
    """Cross product with magnitudes added in place of subtractions: the size that its rounding scales with."""
    (ax, ay, az), (bx, by, bz) = np.abs(a).T, np.abs(b).T
    return stacked_columns(az * by + ay * bz, ax * bz + az * bx, ay * bx + ax * by)


def row_groups(keys: Array) -> Array:
    """(m,) group numbers: equal rows of keys (m, c) form a group, numbered in the order of the keys."""
    order = np.lexsort(keys.T[::-1])  # sorts columns of numbers, where np.unique compares rows one by one
    ordered = keys[order]
    new = np.zeros(len(keys), np.int64)
    for column in ordered.T:
        new[1:] |= column[1:] != column[:-1]
    group = np.empty(len(keys), np.int64)
    group[order] = np.cumsum(new)
    return group


def perpendicular(n: Array) -> Array:
    """(m, 3) a vector at right angles to each row, of at least 0.8 times its length."""
    return np.cross(n, np.eye(3)[np.argmin(np.abs(n), axis=1)])


def triangle_heights(corners: Array) -> Array:
    """(m,) smallest heights of triangles with corners (m, 3, 3)."""
    edges = np.roll(corners, -1, axis=1) - corners
    return norm(cross(edges[:, 0], edges[:, 1])) / norm(edges.reshape(-1, 3)).reshape(-1, 3).max(axis=1)


def mat_vec_rows(m: Array, v: Array) -> Array:
    """m[i] v[i] for each row."""
    return np.einsum("ijk,ik->ij", m, v)


def finite_or_zero(t: Array, t_error: Array) -> Array:
    """t, or 0 where it is not finite and has no bound: a ray that lies in a flat surface."""
    return np.where(np.isinf(t_error) & ~np.isfinite(t), 0.0, t)


def position_error(o: Array, d: Array, t: Array, t_error: Array, ku: float) -> Array:
    """Bound on the error of o + t d, from that of t and from the rounding of the sum."""
    return norm(d) * t_error + ku * (norm(o) + np.abs(t) * norm(d))


# Keys of groups of pixels that share one rounding of the reference (docs/method.md, "Bias"). Means over such groups
# separate a bias from roundings of a primitive's own numbers, which are the same for all rays.


# Faces whose unit normals agree to this are one group: parallel faces may have the same differences of corners.
SAME_NORMAL_TOLERANCE = 2.0**-12

# prims, k (m,), n (m, 3), o (m, 3), d (m, 3) by name -> (m, c) rows that are equal where pixels are of one group
GroupKey = Callable[..., Array]


def by_normal(n: Array, **_: Any) -> Array:
    """Group key of flat primitives: parallel planes, and mirror images of them, may be rounded alike."""
    return np.sort(np.round(np.abs(n) / SAME_NORMAL_TOLERANCE), axis=1)


def by_matrix(prims: Any, k: Array, **_: Any) -> Array:
    """Group key of transformed primitives: abs(to_world), since mirror images round its inverse alike."""
    return np.abs(prims.to_world[k].reshape(len(k), 9))


def by_approach(prims: Any, k: Array, o: Array, d: Array, **_: Any) -> Array:
    """Group key of spheres in the scalar variant: solved in float64, but from the closest approach, at a float32 t."""
    nearest: Array = dot(prims.center[k] - o, d) / dot(d, d)
    return nearest.astype(np.float32)[:, None]


def single_group(k: Array, **_: Any) -> Array:
    """All pixels in one group: for kinds that declare no shared rounding; no bias is tested for them."""
    return np.zeros((len(k), 1))

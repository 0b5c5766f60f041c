"""Predicted intersections with error bounds for float32, and groups of pixels that share a rounding."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.oracle.interface import ExactKind, ExpandStandIns

# Embree drops a triangle with a coordinate beyond this, silently.
LARGEST_COORDINATE = 1.844e18


class Intersections(NamedTuple):
    """Rays and primitives, pairwise: m pairs, one root each. Errors are bounds on what the reference may be off."""

    t: np.ndarray  # (m,) parameter of the intersection, lengths of d
    t_error: np.ndarray  # (m,) inf where float32 cannot resolve it
    n: np.ndarray  # (m, 3) geometric normal
    n_error: np.ndarray  # (m,)
    sh_n: np.ndarray  # (m, 3) shading normal
    sh_error: np.ndarray  # (m,)
    possible: np.ndarray  # (m,) bool: some perturbation within the bound hits
    certain: np.ndarray  # (m,) bool: every perturbation within the bound hits
    p_error: np.ndarray  # (m,) bound on the position, scene units
    uv: np.ndarray  # (m, 3) uv as a point of the kind's UvSpace
    uv_error: np.ndarray  # (m,) bound on that point
    edge: np.ndarray | None = None  # (m, 6) the end points of the one edge a triangle is not certain of, else NaN
    side: np.ndarray | None = None  # (m,) on which side of that edge the triangle lies, -1 or 1

    def take(self, rows: np.ndarray) -> "Intersections":
        """Some of them, by index or mask."""
        return Intersections(*(a[rows] for a in self if a is not None))


# (prims, k (m,), o (m, 3), d (m, 3), ku) -> intersections of primitive k[i] with ray i, one of these per root.
# ku is K times the unit round-off of whoever is judged: KU for the reference, KU_OURS for a float64 caster.
IntersectFunction = Callable[[Any, np.ndarray, np.ndarray, np.ndarray, float], tuple[Intersections, ...]]


# (prims, k (m,), uv (m, 2)) -> (m, 3); NaN where uv are none that the surface has
UvPoints = Callable[[Any, np.ndarray, np.ndarray], np.ndarray]


def plain_uv(_prims: Any, _k: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(u, v, 0): parameters without seam and pole, which are compared as they are."""
    return stacked_columns(*uv.T, np.zeros(len(uv)))


class UvSpace(NamedTuple):
    """Where uv of one kind are compared: where neither a seam nor a pole of the parametrisation is a jump.

    u = 0 and u = 1 of a circle are one point of the plane, and at a pole of a sphere every u is the same point. So
    distances have one bound everywhere, and uv differ from others that mean the same place by nothing.
    """

    subject: UvPoints = plain_uv
    reference: UvPoints | None = plain_uv  # of the reference's uv, whose axes may be others; None: of another surface


class ErrorModel(NamedTuple):
    """The error model of one kind of primitive."""

    intersect: IntersectFunction  # the reference's primitive, or what stands in for it
    bounds: Callable[[Any], tuple[np.ndarray, np.ndarray]]  # prims -> low, high corners (n, 3) of their boxes
    intersect_ours: IntersectFunction | None = None  # our own primitive, where the reference's is a stand-in
    exact: ExactKind | None = None  # our own primitive in whole numbers, for the oracle
    # arrays that stand in for it -> primitives that have an `exact`
    unfold: Mapping[type, ExpandStandIns] | None = None
    uv: UvSpace = UvSpace()


# Many vectors (m, 3) lie column by column in memory: sums over three neighbours take NumPy four times as long, and
# `np.cross` twelve times.


def by_columns(rows: np.ndarray) -> np.ndarray:
    """The same numbers, columns one after the other in memory."""
    return np.asfortranarray(rows)


def stacked_columns(*columns: np.ndarray) -> np.ndarray:
    """(m, c) of columns (m,), one after the other in memory."""
    return np.stack(columns).T


def any_of_columns(rows: np.ndarray) -> np.ndarray:
    """(m,) bool: whether any of a few columns (m, c) is true; `any` over such an axis takes ten times as long."""
    return np.logical_or.reduce([*rows.T])


def all_of_columns(rows: np.ndarray) -> np.ndarray:
    """(m,) bool: whether all of a few columns (m, c) are."""
    return np.logical_and.reduce([*rows.T])


def largest_of_columns(rows: np.ndarray) -> np.ndarray:
    """(m,) the largest of a few numbers (m, c) >= 0 of each row; 0 of none, NaN where there is one."""
    return np.maximum.reduce([np.zeros(len(rows)), *rows.T])


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Row-wise cross product, with the bits of `np.cross`."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return stacked_columns(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


def ceil_log2(x: np.ndarray) -> np.ndarray:
    """The least whole k with x <= 2^k, exactly, for finite x > 0; a logarithm would be rounded."""
    fraction, exponent = np.frexp(x)
    return np.asarray(exponent - (fraction == 0.5), np.int64)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Row-wise dot product."""
    return np.einsum("ij,ij->i", a, b)


def norm(a: np.ndarray) -> np.ndarray:
    """Length of each row."""
    return np.sqrt(dot(a, a))


def unit(a: np.ndarray) -> np.ndarray:
    """Each row divided by its length; zero rows stay."""
    length = norm(a)
    return a / np.where(length > 0.0, length, 1.0)[:, None]


def cross_permanent(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The cross product with every subtraction made an addition of magnitudes: what its rounding scales with."""
    (ax, ay, az), (bx, by, bz) = np.abs(a).T, np.abs(b).T
    return stacked_columns(az * by + ay * bz, ax * bz + az * bx, ay * bx + ax * by)


def row_groups(keys: np.ndarray) -> np.ndarray:
    """(m,) for each row of keys (m, c) the number of its group of equal rows, in the order of the keys."""
    order = np.lexsort(keys.T[::-1])  # sorts columns of numbers, where np.unique compares rows one by one
    ordered = keys[order]
    new = np.zeros(len(keys), np.int64)
    for column in ordered.T:
        new[1:] |= column[1:] != column[:-1]
    group = np.empty(len(keys), np.int64)
    group[order] = np.cumsum(new)
    return group


def mat_vec_rows(m: np.ndarray, v: np.ndarray) -> np.ndarray:
    """m[i] v[i] for each row."""
    return np.einsum("ijk,ik->ij", m, v)


def finite_or_zero(t: np.ndarray, t_error: np.ndarray) -> np.ndarray:
    """t, or 0 where it is NaN and its error infinite: a ray in a surface, edge-on."""
    return np.where(np.isinf(t_error) & ~np.isfinite(t), 0.0, t)


def position_error(o: np.ndarray, d: np.ndarray, t: np.ndarray, t_error: np.ndarray, ku: float) -> np.ndarray:
    """Bound on o + t d: t is off by its error, and the sum is rounded."""
    return norm(d) * t_error + ku * (norm(o) + np.abs(t) * norm(d))


# Group keys of pixels that share one rounding of the reference (docs/method.md, "Bias").
#
# Means over such groups separate a bias from the roundings that a primitive's numbers suffer once, for all rays.


# Faces whose unit normals agree to this share are one group: parallel faces have the same differences of corners.
SAME_NORMAL_TOLERANCE = 2.0**-12

# (prims, k (m,), n (m, 3), o (m, 3), d (m, 3)) -> (m, c) rows that are equal where pixels are of one group
GroupKey = Callable[[Any, np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def by_normal(_prims: Any, _k: np.ndarray, n: np.ndarray, _o: np.ndarray, _d: np.ndarray) -> np.ndarray:
    """Flat: what is rounded is the plane, and parallel ones may be rounded alike; so may mirror images be."""
    key: np.ndarray = np.sort(np.round(np.abs(n) / SAME_NORMAL_TOLERANCE), axis=1)
    return key


def by_matrix(prims: Any, k: np.ndarray, _n: np.ndarray, _o: np.ndarray, _d: np.ndarray) -> np.ndarray:
    """Through a matrix: what is rounded is its inverse; a mirror image's has the same magnitudes."""
    key: np.ndarray = np.abs(prims.to_world[k].reshape(len(k), 9))
    return key


def by_approach(prims: Any, k: np.ndarray, _n: np.ndarray, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Spheres are solved in float64, but from the point nearest to the centre, at a t that is rounded to float32."""
    nearest: np.ndarray = dot(prims.center[k] - o, d) / dot(d, d)
    return nearest.astype(np.float32)[:, None]


def by_center(prims: Any, k: np.ndarray, _n: np.ndarray, _o: np.ndarray, _d: np.ndarray) -> np.ndarray:
    """Spheres in float32 throughout, by the LLVM variant: what is rounded is the centre relative to the origin."""
    center: np.ndarray = prims.center[k]
    return center


def single_group(_prims: Any, k: np.ndarray, _n: np.ndarray, _o: np.ndarray, _d: np.ndarray) -> np.ndarray:
    """One group: for kinds that declare no shared rounding, of which no bias is tested."""
    return np.zeros((len(k), 1))

"""The normal where a ray meets a primitive, in whole numbers and fractions, and how far off a float64 may put it."""

from functools import partial
from typing import Any

import numpy as np
from oracle_aims import root_bracket
from oracle_fractions import F, Vector, exactly, solved, sub

from caster.geometry.packing import Packed
from mitsuba_ref.oracle.exact_numbers import Root

U = 2.0**-53
BITS = 240  # of t, behind the point of its own scale

# |n| of a vector that was divided by its computed length: three squares and two sums (2.5 u of the square, as the
# largest term of a sum of positive numbers is rounded thrice), halved by the root, which rounds once, and a quotient.
UNIT_ATOL = 4 * U

# As in conditions.py: so many u of the normal's own condition; `conditions` below count every operand once.
NORMAL_US = 64.0


def cross(a: Vector, b: Vector) -> Vector:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def inverse_times(m: list[Vector], v: Vector) -> Vector:
    found = solved(m, v)
    assert found is not None
    return found[0]


def unit(v: Vector) -> np.ndarray:
    """v at length 1, within 4 u."""
    largest = max(abs(x) for x in v)
    scaled = np.array([float(x / largest) for x in v])
    return scaled / np.sqrt(np.dot(scaled, scaled))


def point(o: Any, d: Any, t: Root) -> Vector:
    """o + t d; t to BITS more bits than its own size needs."""
    size = float(t)
    low, _ = root_bracket(t, BITS + max(0, t.e - int(np.frexp(size)[1])) + t.s.bit_length())
    return [p + low * q for p, q in zip(exactly(o), exactly(d), strict=True)]


def normal(packed: Packed, prim: int, o: Any, d: Any, t: Root) -> np.ndarray:
    """(3,) unit, as the shape says: outwards, or to the side of +z, or by the order of the corners."""
    kind, k = packed.place_of(prim)
    prims, name = kind.prims, type(kind.prims).__name__
    if name == "Triangles":
        a, b, c = exactly(prims.vertices[prims.faces[k]])
        return unit(cross(sub(b, a), sub(c, a)))
    if name == "Planes":
        return unit(exactly(prims.normal[k]))
    if name == "RoundSegments":
        away, axis = sub(point(o, d, t), exactly(prims.start[k])), sub(exactly(prims.end[k]), exactly(prims.start[k]))
        return unit(
            [x - share_along(away, axis, exactly(prims.radius[k])) * y for x, y in zip(away, axis, strict=True)]
        )
    away = sub(point(o, d, t), exactly(prims.center[k]))
    if name == "Spheres":
        return unit(away)
    rows = exactly(prims.to_world[k])
    q = [F(0), F(0), F(1)] if name == "Disks" else inverse_times(rows, away)
    if name == "Cylinders":
        q[2] = F(0)
    return unit(inverse_times([list(column) for column in zip(*rows, strict=True)], q))


def share_along(away: Any, axis: Any, radii: Any) -> Any:
    """Where along a segment the sphere lies that touches the hull in the point `away` from the start."""
    change, length_squared = radii[1] - radii[0], sum(y * y for y in axis)
    share = (sum(x * y for x, y in zip(away, axis, strict=True)) + radii[0] * change) / (
        length_squared - change * change
    )
    return min(max(share, 0), 1)


def bound(packed: Packed, prim: int, o: np.ndarray, d: np.ndarray, t: float, off: float) -> float:
    """How far the normal may be off, at most 2; off: how far t is.

    Flat: roundings of a cross product against its permanent. Sphere: the closest approach is off by u of the origin's
    distance, half the chord by as much times r / h, but never by more than the root of that; or the point at t is off
    by u of the way there and by t's own error; the better of the two. Through a matrix: the point in object space is
    off by its own roundings and by t's, and is stretched by the matrix on the way back.
    """
    kind, k = packed.place_of(prim)
    prims, name = kind.prims, type(kind.prims).__name__
    with np.errstate(all="ignore"):
        size = BOUNDS[name](prims, k, o, d, t, off)
    return float(np.fmin(NORMAL_US * U * size, 2.0)) if np.isfinite(size) else 2.0


def _triangle(prims: Any, k: int, o: np.ndarray, d: np.ndarray, t: float, off: float) -> float:
    a, b, c = prims.vertices[prims.faces[k]]
    e1, e2 = (v / np.abs(v).max() for v in (b - a, c - a))
    spread = np.abs(e1[[1, 2, 0]] * e2[[2, 0, 1]]) + np.abs(e1[[2, 0, 1]] * e2[[1, 2, 0]])
    return 1.0 + np.linalg.norm(spread) / np.linalg.norm(np.cross(e1, e2))


def _flat(prims: Any, k: int, o: np.ndarray, d: np.ndarray, t: float, off: float) -> float:
    return 1.0


def _sphere(prims: Any, k: int, o: np.ndarray, d: np.ndarray, t: float, off: float) -> float:
    r = prims.radius[k]
    f = (o - prims.center[k]) / r
    g = np.cross(f, d / np.linalg.norm(d))
    error = NORMAL_US * U * (np.abs(f).sum() + 1.0)
    h = np.sqrt(max(1.0 - np.dot(g, g), 0.0))
    approached = (error + min(error / h if h else np.inf, np.sqrt(error))) / (NORMAL_US * U)
    reached = np.abs(f).sum() + np.abs(t * d).sum() / r + np.linalg.norm(d) * off / r / U
    return min(approached, reached) + 1.0


def _through_matrix(
    prims: Any, k: int, o: np.ndarray, d: np.ndarray, t: float, off: float, flat: bool = False
) -> float:
    m, away = prims.to_object[k], o - prims.center[k]
    q, e = m @ (away + t * d), m @ d
    reach = np.abs(m) @ (np.abs(away) + np.abs(t * d))
    if flat:
        q, e, reach = (v * [1.0, 1.0, 0.0] for v in (q, e, reach))
    moved = np.linalg.norm(reach) + np.linalg.norm(e) * off / U
    back = m.T @ (q / np.linalg.norm(q))
    return (moved + 1.0) * np.linalg.norm(m, "fro") / np.linalg.norm(back)


def _segment(prims: Any, k: int, o: np.ndarray, d: np.ndarray, t: float, off: float) -> float:
    """The point's error over the radius there; it moves the touching sphere along the segment as well."""
    away, axis, radii = o - prims.start[k], prims.end[k] - prims.start[k], prims.radius[k]
    share, change, length_squared = share_along(away + t * d, axis, radii), radii[1] - radii[0], np.dot(axis, axis)
    radius = radii[0] + share * change
    moved = np.abs(away).sum() + np.abs(t * d).sum() + np.linalg.norm(axis) + np.linalg.norm(d) * off / U
    return moved / radius * (1.0 + length_squared / (length_squared - change * change)) + 1.0


BOUNDS = {
    "Triangles": _triangle,
    "Planes": _flat,
    "Disks": _flat,
    "Spheres": _sphere,
    "Ellipsoids": _through_matrix,
    "OuterEllipsoids": _through_matrix,
    "RoundSegments": _segment,
    "Cylinders": partial(_through_matrix, flat=True),
}

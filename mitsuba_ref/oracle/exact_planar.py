"""Exact intersection with triangles, by signs of determinants, and with planes and disks, by linear equations."""

from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.oracle import exact_quadrics
from mitsuba_ref.oracle.exact_numbers import IntegerRay, Integers3, Root, cross, dot, scaled, shifted, sub
from mitsuba_ref.oracle.exact_quadrics import DEGENERATE, Affine, line_sphere_roots
from mitsuba_ref.oracle.implicit_surfaces import AsVector, ImplicitSurface
from mitsuba_ref.oracle.interface import NO_INTERSECTION, Contact, ExactKind, LineIntersections

LINE_IN_PLANE = LineIntersections((), (Contact("edge_on", None, None),))


class IntegerPlane(NamedTuple):
    """All p with normal . (p - point 2^-k) = 0; the scale of the normal does not matter."""

    normal: Integers3
    point: Integers3
    k: int


def prepare_plane(prims: Any, k: int) -> IntegerPlane:
    (nx, ny, nz), _ = scaled(prims.normal[k].tolist())
    (x, y, z), scale = scaled(prims.point[k].tolist())
    return IntegerPlane((nx, ny, nz), (x, y, z), scale)


def intersect_plane(plane: IntegerPlane, ray: IntegerRay) -> LineIntersections:
    if not any(plane.normal):
        return DEGENERATE
    scale = max(plane.k, ray.ko)
    away = sub(shifted(plane.point, scale - plane.k), shifted(ray.o, scale - ray.ko))
    height, slope = dot(plane.normal, away), dot(plane.normal, ray.d)
    if slope:
        return LineIntersections(((Root(height, 0, 0, slope, ray.kd - scale), "inside"),))
    return NO_INTERSECTION if height else LINE_IN_PLANE


def intersect_disk(disk: Affine, ray: IntegerRay) -> LineIntersections:
    """z is 0 at s = -o.z / d.z; x^2 + y^2 there is compared with size^2, both times d.z^2."""
    if not disk.determinant:
        return DEGENERATE
    (ox, oy, oz), (dx, dy, dz), size, e = exact_quadrics.to_object_space(disk, ray)
    if not dz:
        return NO_INTERSECTION if oz else _along_disk_plane(ox, oy, dx, dy, size, e)
    x, y = ox * dz - oz * dx, oy * dz - oz * dy
    beyond = x * x + y * y - (size * dz) ** 2
    if beyond > 0:
        return NO_INTERSECTION
    return LineIntersections(((Root(-oz, 0, 0, dz, e), "inside" if beyond else "rim"),))


def _along_disk_plane(ox: int, oy: int, dx: int, dy: int, size: int, e: int) -> LineIntersections:
    """A ray in the plane of a disk: the contact from where it enters the circle to where it leaves."""
    ends = line_sphere_roots((ox, oy, 0), (dx, dy, 0), size, e)
    return LineIntersections((), (Contact("edge_on", ends[0], ends[-1]),)) if ends else NO_INTERSECTION


def infinite_boxes(prims: Any) -> tuple[np.ndarray, np.ndarray]:
    everywhere = np.full(np.shape(prims.point), np.inf)
    return -everywhere, everywhere


def usable_plane(prims: Any) -> np.ndarray:
    return np.isfinite(prims.normal).all(axis=1) & np.isfinite(prims.point).all(axis=1)


def plane_surface(prims: Any, k: Any, vector: AsVector) -> ImplicitSurface:
    return ImplicitSurface(vector(prims.point[k]), (vector(prims.normal[k]),))


PLANES = ExactKind(infinite_boxes, prepare_plane, intersect_plane, usable=usable_plane, surface=plane_surface)
DISKS = ExactKind(
    exact_quadrics.affine_boxes,
    exact_quadrics.prepare_affine,
    intersect_disk,
    usable=exact_quadrics.usable_affine,
    surface=exact_quadrics.disk_surface,
)


# Exact ray-triangle intersection by the signs of three determinants.


# Embree drops a face with a coordinate as large as this, and so does the oracle.
LARGEST_COORDINATE = 1.844e18

WHERE = ("inside", "edge", "vertex")  # by the number of edge functions that are 0


class IntegerTriangle(NamedTuple):
    """Three corners v[j] 2^-k."""

    v: tuple[Integers3, Integers3, Integers3]
    k: int
    dropped: bool


def prepare_triangle(prims: Any, k: int) -> IntegerTriangle:
    numbers = prims.vertices[prims.faces[k]].ravel().tolist()
    (ax, ay, az, bx, by, bz, cx, cy, cz), scale = scaled(numbers)
    large = any(abs(x) >= LARGEST_COORDINATE for x in numbers)
    return IntegerTriangle(((ax, ay, az), (bx, by, bz), (cx, cy, cz)), scale, large)


def intersect_triangle(face: IntegerTriangle, ray: IntegerRay) -> LineIntersections:
    """With corners a, b, c relative to o and normal N: t d.N = a.N, where a.N = a.(b x c) and d.N = U + V + W."""
    scale = max(face.k, ray.ko)
    o = shifted(ray.o, scale - ray.ko)
    a, b, c = (sub(shifted(v, scale - face.k), o) for v in face.v)
    bc = cross(b, c)
    u, v, w = dot(ray.d, bc), dot(ray.d, cross(c, a)), dot(ray.d, cross(a, b))
    if (u < 0 or v < 0 or w < 0) and (u > 0 or v > 0 or w > 0):
        return NO_INTERSECTION
    area = u + v + w
    if area == 0:  # then all three are 0
        return _edge_on((a, b, c), ray, scale)
    t = Root(dot(a, bc), 0, 0, area, ray.kd - scale)
    if face.dropped:
        return LineIntersections((), (Contact("dropped", t, t),))
    return LineIntersections(((t, WHERE[(u == 0) + (v == 0) + (w == 0)]),))


def _edge_on(corners: tuple[Integers3, Integers3, Integers3], ray: IntegerRay, scale: int) -> LineIntersections:
    """A ray in the plane of a triangle: no hit, but a contact if it passes through the triangle.

    Projected along d, all corners lie on one line through the ray, at offsets s. The ray crosses corners with s = 0 and
    edges whose ends have s of opposite signs.
    """
    axis = next(i for i in range(3) if ray.d[i])
    flat = [cross(corner, ray.d) for corner in corners]
    line = next((f for f in flat if any(f)), (0, 0, 0))
    offsets = [dot(f, line) for f in flat]
    steps = [Fraction(corner[axis], ray.d[axis]) for corner in corners]  # t of the corners' projections onto the ray
    crossed = [step for offset, step in zip(offsets, steps, strict=True) if offset == 0]
    for i, j in ((0, 1), (1, 2), (2, 0)):
        if offsets[i] * offsets[j] < 0:
            crossed.append((offsets[j] * steps[i] - offsets[i] * steps[j]) / (offsets[j] - offsets[i]))
    if not crossed:
        return NO_INTERSECTION
    a, b, c = corners
    why = "edge_on" if any(cross(sub(b, a), sub(c, a))) else "degenerate"
    first, last = (Root(t.numerator, 0, 0, t.denominator, ray.kd - scale) for t in (min(crossed), max(crossed)))
    return LineIntersections((), (Contact(why, first, last),))


BOXES_PER_CHUNK = 1 << 16  # triangles whose corners are gathered at once


def triangle_boxes(prims: Any) -> tuple[np.ndarray, np.ndarray]:
    low, high = np.empty((len(prims.faces), 3)), np.empty((len(prims.faces), 3))
    for start in range(0, len(low), BOXES_PER_CHUNK):
        rows = slice(start, start + BOXES_PER_CHUNK)
        a, b, c = (prims.vertices[corner] for corner in prims.faces[rows].T)
        low[rows], high[rows] = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    return low, high


def finite_faces(prims: Any) -> np.ndarray:
    """All but faces with a corner that is nowhere."""
    return np.isfinite(prims.vertices).all(axis=1)[prims.faces].all(axis=1)


# How far d.(b x c) in float64 may be off, b and c being rounded differences: every term d_i b_j c_k passes at most
# seven roundings (two differences, two products, three sums), so it is off by (1 + u)^7 - 1 < 8 u of itself,
# u = 2^-53. P, the sum of the terms' magnitudes, is computed with at most seven roundings, too: 8 u P <= 9 u fl(P).
# Forming the bound rounds twice more. 16 u leaves room for all of it.
EDGE_RTOL = 16 * 2.0**-53

# Products below 2^-1022 are off by 2^-1075 instead. There are six of them before, and three after, they are multiplied
# by d, in the edge function and in P each: less than 2^-1071 (1 + |d|_1) together.
EDGE_ATOL = 2.0**-1070


def may_intersect(prims: Any, k: np.ndarray, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """False if two edge functions certainly have opposite signs; True if anything overflows."""
    with np.errstate(all="ignore"):
        d = d.T
        a, b, c = (prims.vertices[prims.faces[k, j]].T - o.T for j in range(3))
        least = EDGE_ATOL * (1.0 + np.abs(d).sum(axis=0))
        positive, negative = np.zeros((2, len(k)), bool)
        for p, q in ((b, c), (c, a), (a, b)):
            edge, size = _edge_function(p, q, d)
            error = EDGE_RTOL * size + least  # NaN or inf where something overflows: then neither is certain
            positive |= edge > error
            negative |= edge < -error
    return ~(positive & negative)


def _edge_function(p: np.ndarray, q: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """d . (p x q) of columns (3, m), and the sum of the magnitudes of its terms."""
    edge, size = np.zeros((2, p.shape[1]))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        first, second = p[j] * q[k], p[k] * q[j]
        edge += d[i] * (first - second)
        size += np.abs(d[i]) * (np.abs(first) + np.abs(second))
    return edge, size


def triangle_surface(prims: Any, k: Any, vector: AsVector) -> ImplicitSurface:
    a, b, c = (vector(prims.vertices[prims.faces[k][..., corner]]) for corner in range(3))
    return ImplicitSurface(a, (cross(sub(b, a), sub(c, a)),), corners=(a, b, c))


TRIANGLES = ExactKind(
    triangle_boxes, prepare_triangle, intersect_triangle, may_intersect, present=finite_faces, surface=triangle_surface
)

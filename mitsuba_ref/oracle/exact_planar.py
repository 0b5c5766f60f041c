"""Exact intersection with planes, by a linear equation, and with triangles, by signs of determinants."""

from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.oracle.exact_numbers import IntegerRay, Integers3, Root, cross, dot, scaled_vectors, shifted, sub
from mitsuba_ref.oracle.implicit_surfaces import AsVector, ImplicitSurface
from mitsuba_ref.oracle.interface import DEGENERATE, NO_INTERSECTION, Contact, ExactKind, LineIntersections, contact

LINE_IN_PLANE = LineIntersections((), (Contact("edge_on", None, None),))


class IntegerPlane(NamedTuple):
    """All p with normal . (p - point 2^-k) = 0; the scale of the normal does not matter."""

    normal: Integers3
    point: Integers3
    k: int


def prepare_plane(prims: Any, k: int) -> IntegerPlane:
    (normal, point), scale = scaled_vectors(np.stack([prims.normal[k], prims.point[k]]))
    return IntegerPlane(normal, point, scale)


def intersect_plane(plane: IntegerPlane, ray: IntegerRay) -> LineIntersections:
    if not any(plane.normal):
        return DEGENERATE
    scale = max(plane.k, ray.ko)
    away = sub(shifted(plane.point, scale - plane.k), shifted(ray.o, scale - ray.ko))
    height, slope = dot(plane.normal, away), dot(plane.normal, ray.d)
    if slope:
        return LineIntersections(((Root(height, 0, 0, slope, ray.kd - scale), "inside"),))
    return NO_INTERSECTION if height else LINE_IN_PLANE


def infinite_boxes(prims: Any) -> tuple[np.ndarray, np.ndarray]:
    everywhere = np.full(np.shape(prims.point), np.inf)
    return -everywhere, everywhere


def plane_surface(prims: Any, k: Any, vector: AsVector) -> ImplicitSurface:
    return ImplicitSurface(vector(prims.point[k]), (vector(prims.normal[k]),))


PLANES = ExactKind(infinite_boxes, prepare_plane, intersect_plane, ("normal", "point"), surface=plane_surface)


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
    corners = prims.vertices[prims.faces[k]]
    (a, b, c), scale = scaled_vectors(corners)
    return IntegerTriangle((a, b, c), scale, bool((np.abs(corners) >= LARGEST_COORDINATE).any()))


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
        return contact("dropped", [t])
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
    a, b, c = corners
    why = "edge_on" if any(cross(sub(b, a), sub(c, a))) else "degenerate"
    return contact(why, [Root(t.numerator, 0, 0, t.denominator, ray.kd - scale) for t in crossed])


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


def triangle_surface(prims: Any, k: Any, vector: AsVector) -> ImplicitSurface:
    a, b, c = (vector(prims.vertices[prims.faces[k][..., corner]]) for corner in range(3))
    return ImplicitSurface(a, (cross(sub(b, a), sub(c, a)),), corners=(a, b, c))


TRIANGLES = ExactKind(
    triangle_boxes, prepare_triangle, intersect_triangle, present=finite_faces, surface=triangle_surface
)

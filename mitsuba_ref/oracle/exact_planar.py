"""Exact intersection with planes, by a linear equation, and with triangles, by signs of determinants."""

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from mitsuba_ref.oracle.exact_numbers import IntegerRay, Integers3, Root, cross, dot, shifted, sub
from mitsuba_ref.oracle.implicit_surfaces import ImplicitSurface, Vector
from mitsuba_ref.oracle.interface import DEGENERATE, NO_INTERSECTION, Contact, ExactKind, LineIntersections, contact

LINE_IN_PLANE = LineIntersections((), (Contact("edge_on", None, None),))


def plane_vectors(prims: Any, k: Any) -> np.ndarray:
    return np.stack([prims.normal[k], prims.point[k]], axis=-2)


def intersect_plane(plane: Sequence[Integers3], bits: int, ray: IntegerRay) -> LineIntersections:
    """All p with normal . (p - point) = 0; the scale of the normal does not matter."""
    normal, point = plane
    if not any(normal):
        return DEGENERATE
    height, slope = dot(normal, sub(shifted(point, bits), ray.o)), dot(normal, ray.d)
    if slope:
        return LineIntersections(((Root(height, 0, 0, slope, ray.e), "inside"),))
    return NO_INTERSECTION if height else LINE_IN_PLANE


def infinite_boxes(prims: Any) -> tuple[np.ndarray, np.ndarray]:
    everywhere = np.full(np.shape(prims.point), np.inf)
    return -everywhere, everywhere


def plane_surface(plane: Sequence[Vector]) -> ImplicitSurface:
    normal, point = plane
    return ImplicitSurface(point, (normal,))


PLANES = ExactKind(infinite_boxes, plane_vectors, intersect_plane, surface=plane_surface)


# Exact ray-triangle intersection by the signs of three determinants.


# Embree drops a face with a coordinate as large as this, and so does the oracle.
LARGEST_COORDINATE = 1844 * 10**15

WHERE = ("inside", "edge", "vertex")  # by the number of edge functions that are 0


def corners_of(prims: Any, k: Any) -> np.ndarray:
    corners: np.ndarray = prims.vertices[prims.faces[k]]
    return corners


def intersect_triangle(corners: Sequence[Integers3], bits: int, ray: IntegerRay) -> LineIntersections:
    """With corners a, b, c relative to o and normal N: t d.N = a.N, where a.N = a.(b x c) and d.N = U + V + W."""
    a, b, c = (sub(shifted(corner, bits), ray.o) for corner in corners)
    bc = cross(b, c)
    u, v, w = dot(ray.d, bc), dot(ray.d, cross(c, a)), dot(ray.d, cross(a, b))
    if (u < 0 or v < 0 or w < 0) and (u > 0 or v > 0 or w > 0):
        return NO_INTERSECTION
    area = u + v + w
    if area == 0:  # then all three are 0
        return _edge_on((a, b, c), ray)
    t = Root(dot(a, bc), 0, 0, area, ray.e)
    if any(abs(x) >= LARGEST_COORDINATE << (ray.ko - bits) for corner in corners for x in corner):
        return contact("dropped", [t])
    return LineIntersections(((t, WHERE[(u == 0) + (v == 0) + (w == 0)]),))


def _edge_on(corners: tuple[Integers3, Integers3, Integers3], ray: IntegerRay) -> LineIntersections:
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
    return contact(why, [Root(t.numerator, 0, 0, t.denominator, ray.e) for t in crossed])


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


def triangle_surface(corners: Sequence[Vector]) -> ImplicitSurface:
    a, b, c = corners
    return ImplicitSurface(a, (cross(sub(b, a), sub(c, a)),), corners=(a, b, c))


TRIANGLES = ExactKind(triangle_boxes, corners_of, intersect_triangle, finite_faces, triangle_surface)

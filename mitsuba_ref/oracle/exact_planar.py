"""Exact planar surfaces: planes and disks, by linear equations in integers."""

from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.oracle import exact_quadrics
from mitsuba_ref.oracle.exact_numbers import IntegerRay, Integers3, Root, dot, scaled, shifted, sub
from mitsuba_ref.oracle.exact_quadrics import Affine, line_sphere_roots
from mitsuba_ref.oracle.interface import NO_INTERSECTION, Contact, ExactKind, LineIntersections

LINE_IN_PLANE = LineIntersections((), (Contact("edge_on", None, None),))
DEGENERATE = LineIntersections((), (Contact("degenerate", None, None),))


class IntegerPlane(NamedTuple):
    """All p with normal . (p - point 2^-k) = 0; a normal may be scaled by anything."""

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
    """z vanishes at s = -o.z / d.z, and x^2 + y^2 there is compared with size^2, all times d.z^2."""
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
    """The ray lies in the disk's plane: from where to where it runs along the disk."""
    ends = line_sphere_roots((ox, oy, 0), (dx, dy, 0), size, e)
    return LineIntersections((), (Contact("edge_on", ends[0], ends[-1]),)) if ends else NO_INTERSECTION


def infinite_boxes(prims: Any) -> tuple[np.ndarray, np.ndarray]:
    everywhere = np.full(np.shape(prims.point), np.inf)
    return -everywhere, everywhere


def usable_plane(prims: Any) -> np.ndarray:
    return np.isfinite(prims.normal).all(axis=1) & np.isfinite(prims.point).all(axis=1)


PLANES = ExactKind(infinite_boxes, prepare_plane, intersect_plane, usable=usable_plane)
DISKS = ExactKind(
    exact_quadrics.disk_boxes,
    exact_quadrics.prepare_affine,
    intersect_disk,
    usable=exact_quadrics.usable_affine,
)

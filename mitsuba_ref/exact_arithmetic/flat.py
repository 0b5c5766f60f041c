"""Planes and disks: where a linear equation vanishes."""

from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.exact_arithmetic import affine
from mitsuba_ref.exact_arithmetic.affine import Affine
from mitsuba_ref.exact_arithmetic.integers import IntegerRay, Integers3, dot, scaled, shifted, sub
from mitsuba_ref.exact_arithmetic.kind import NOTHING, ExactKind, Met, Touch
from mitsuba_ref.exact_arithmetic.root import Root
from mitsuba_ref.exact_arithmetic.round import line_and_ball

EVERYWHERE = Met((), (Touch("edge_on", None, None),))
WITHOUT_INSIDE = Met((), (Touch("degenerate", None, None),))


class Level(NamedTuple):
    """All p with normal . (p - point 2^-k) = 0; a normal may be scaled by anything."""

    normal: Integers3
    point: Integers3
    k: int


def prepare_plane(prims: Any, k: int) -> Level:
    (nx, ny, nz), _ = scaled(prims.normal[k].tolist())
    (x, y, z), scale = scaled(prims.point[k].tolist())
    return Level((nx, ny, nz), (x, y, z), scale)


def meet_plane(plane: Level, ray: IntegerRay) -> Met:
    if not any(plane.normal):
        return WITHOUT_INSIDE
    scale = max(plane.k, ray.ko)
    away = sub(shifted(plane.point, scale - plane.k), shifted(ray.o, scale - ray.ko))
    height, slope = dot(plane.normal, away), dot(plane.normal, ray.d)
    if slope:
        return Met(((Root(height, 0, 0, slope, ray.kd - scale), "inside"),))
    return NOTHING if height else EVERYWHERE


def meet_disk(disk: Affine, ray: IntegerRay) -> Met:
    """z vanishes at s = -o.z / d.z, and x^2 + y^2 there is compared with size^2, all times d.z^2."""
    if not disk.determinant:
        return WITHOUT_INSIDE
    (ox, oy, oz), (dx, dy, dz), size, e = affine.seen(disk, ray)
    if not dz:
        return NOTHING if oz else _along_a_disk(ox, oy, dx, dy, size, e)
    x, y = ox * dz - oz * dx, oy * dz - oz * dy
    beyond = x * x + y * y - (size * dz) ** 2
    if beyond > 0:
        return NOTHING
    return Met(((Root(-oz, 0, 0, dz, e), "inside" if beyond else "rim"),))


def _along_a_disk(ox: int, oy: int, dx: int, dy: int, size: int, e: int) -> Met:
    """The ray lies in the disk's plane: from where to where it runs along the disk."""
    ends = line_and_ball((ox, oy, 0), (dx, dy, 0), size, e)
    return Met((), (Touch("edge_on", ends[0], ends[-1]),)) if ends else NOTHING


def boundless(prims: Any) -> tuple[np.ndarray, np.ndarray]:
    everywhere = np.full(np.shape(prims.point), np.inf)
    return -everywhere, everywhere


def usable_plane(prims: Any) -> np.ndarray:
    return np.isfinite(prims.normal).all(axis=1) & np.isfinite(prims.point).all(axis=1)


PLANES = ExactKind(boundless, prepare_plane, meet_plane, usable=usable_plane)
DISKS = ExactKind(affine.flat_boxes, affine.prepare, meet_disk, usable=affine.usable)

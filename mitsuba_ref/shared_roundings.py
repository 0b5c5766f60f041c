"""Which pixels share a rounding of the reference's, by kind of primitive (docs/method.md, "Bias")."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from mitsuba_ref.cases import CYLINDERS, DISKS, ELLIPSOIDS, PLANES, SPHERES, TRIANGLES
from mitsuba_ref.meeting import dot

# Faces whose unit normals agree to this share are one group: parallel faces have the same differences of corners.
SAME_NORMAL = 2.0**-12

# (prims, k (m,), n (m, 3), o (m, 3), d (m, 3)) -> (m, c) rows that are equal where pixels are of one group
Key = Callable[[Any, np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def by_normal(_prims: Any, _k: np.ndarray, n: np.ndarray, _o: np.ndarray, _d: np.ndarray) -> np.ndarray:
    """Flat: what is rounded is the plane, and parallel ones may be rounded alike; so may mirror images be."""
    key: np.ndarray = np.sort(np.round(np.abs(n) / SAME_NORMAL), axis=1)
    return key


def by_corner(
    axis: int, prims: Any, k: np.ndarray, _n: np.ndarray, _o: np.ndarray, _d: np.ndarray
) -> np.ndarray:
    """Faces on rings and grids: what is rounded is one coordinate of many corners, as seen from the ray's origin."""
    corner: np.ndarray = np.abs(prims.vertices[prims.faces[k, 0], axis])
    return corner[:, None]


def by_matrix(prims: Any, k: np.ndarray, _n: np.ndarray, _o: np.ndarray, _d: np.ndarray) -> np.ndarray:
    """Through a matrix: what is rounded is its inverse; a mirror image's has the same magnitudes."""
    key: np.ndarray = np.abs(prims.to_world[k].reshape(len(k), 9))
    return key


def by_approach(prims: Any, k: np.ndarray, _n: np.ndarray, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Balls are solved in float64, but from the point nearest to the centre, which lies at a t rounded to float32."""
    nearest: np.ndarray = dot(prims.center[k] - o, d) / dot(d, d)
    return nearest.astype(np.float32)[:, None]


def by_center(prims: Any, k: np.ndarray, _n: np.ndarray, _o: np.ndarray, _d: np.ndarray) -> np.ndarray:
    """Balls in float32 throughout, as the LLVM variant has them: what is rounded is the centre from the origin."""
    center: np.ndarray = prims.center[k]
    return center


def all_one(_prims: Any, k: np.ndarray, _n: np.ndarray, _o: np.ndarray, _d: np.ndarray) -> np.ndarray:
    """A kind of which nobody has said what is rounded for many pixels at once: it can tell nothing."""
    return np.zeros((len(k), 1))


# All ways in which a rounding may be common to many pixels. The one that explains a leaning best is taken.
GROUPS: Mapping[str, Sequence[Key]] = {
    TRIANGLES: (by_normal, *(partial(by_corner, axis) for axis in range(3))),
    PLANES: (by_normal,),
    DISKS: (by_normal,),
    CYLINDERS: (by_matrix,),
    ELLIPSOIDS: (by_matrix,),
    SPHERES: (by_approach,),
}
GROUPS_OF_LLVM = {**GROUPS, SPHERES: (by_center,)}

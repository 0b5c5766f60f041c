"""Group keys of pixels that share one rounding of the reference (docs/method.md, "Bias").

Means over such groups separate a bias from the roundings that a primitive's numbers suffer once, for all rays.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from mitsuba_ref.error_model.intersections import dot

# Faces whose unit normals agree to this share are one group: parallel faces have the same differences of corners.
SAME_NORMAL_TOLERANCE = 2.0**-12

# (prims, k (m,), n (m, 3), o (m, 3), d (m, 3)) -> (m, c) rows that are equal where pixels are of one group
GroupKey = Callable[[Any, np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def by_normal(_prims: Any, _k: np.ndarray, n: np.ndarray, _o: np.ndarray, _d: np.ndarray) -> np.ndarray:
    """Flat: what is rounded is the plane, and parallel ones may be rounded alike; so may mirror images be."""
    key: np.ndarray = np.sort(np.round(np.abs(n) / SAME_NORMAL_TOLERANCE), axis=1)
    return key


def by_corner(
    axis: int, prims: Any, k: np.ndarray, _n: np.ndarray, _o: np.ndarray, _d: np.ndarray
) -> np.ndarray:
    """Faces on rings and grids: what is rounded is one coordinate of many corners, relative to the ray's origin."""
    corner: np.ndarray = np.abs(prims.vertices[prims.faces[k, 0], axis])
    return corner[:, None]


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

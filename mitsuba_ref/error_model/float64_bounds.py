"""Bounds on the float64 rounding of our caster's t, images and surfaces, against exact answers."""

from collections.abc import Sequence

import numpy as np

from caster.geometry.packing import Packed
from caster.scene.model import Scene
from mitsuba_ref.error_model.intersections import KU_OURS, Intersections
from mitsuba_ref.error_model.scene_model import reference_of

# t itself is a float64, and cast scales it once more: half a unit in the last place each, and the least float64
# where it is denormal.
T_ROUNDING_ULPS = 1.0

# Below 2^-1022 numbers are rounded to multiples of 2^-1074, not to a fraction of themselves, which the error model
# does not cover. A dozen such roundings over a slope of no less than 2^-60 put t off by no more than this.
UNDERFLOW_BOUND = 2.0**-1010

# depth = t |d|: the length passes at most 4 roundings, the product one, and t is found again by a division.
DEPTH_ULPS = 4.0

# unit() divides by a rounded length: each component passes at most four roundings, so its square is off by 8 u.
UNIT_LENGTH_ATOL = 16 * 2.0**-53


def t_bounds(
    scene: Scene,
    packed: Packed,
    hits: tuple[np.ndarray, np.ndarray],
    rays: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """(n,) bound on |t - exact t| of each hit; inf where float64 cannot resolve it, NaN on a miss.

    hits: t, primitive number (n,). rays: o, d (n, 3). The judge's error model with K u of float64: numbers perturbed by
    4 units in their last places, times the condition of each intersection, at the root nearest to t.
    """
    (t, prim), (o, d) = hits, rays
    bounds = np.full(len(t), np.nan)
    shape = packed.shape_of(prim)
    for number in np.unique(shape[prim >= 0]):
        rows = np.flatnonzero((shape == number) & (prim >= 0))
        part = packed.parts[number]
        model = reference_of(scene.shapes[number]).model_of(part)
        intersect = model.intersect_ours or model.intersect
        with np.errstate(all="ignore"):
            k = prim[rows] - packed.first[number]
            bounds[rows] = _error_of_nearest_root(t[rows], intersect(part, k, o[rows], d[rows], KU_OURS))
    with np.errstate(all="ignore"):
        return bounds + T_ROUNDING_ULPS * np.spacing(np.abs(t)) + UNDERFLOW_BOUND


def _error_of_nearest_root(t: np.ndarray, roots: Sequence[Intersections]) -> np.ndarray:
    distance = np.array([np.abs(root.t - t) for root in roots])
    errors = np.array([root.t_error for root in roots])
    nearest = np.argmin(np.where(np.isnan(distance), np.inf, distance), axis=0)
    error = errors[nearest, np.arange(len(t))]
    return np.where(np.isnan(error), np.inf, error)

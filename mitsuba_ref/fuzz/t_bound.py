"""How far float64 rounding may put a t from the exact one."""

from collections.abc import Sequence

import numpy as np

from caster.packing import Packed
from caster.scene import Scene
from mitsuba_ref.fuzz.routes import Found
from mitsuba_ref.meeting import KU_OURS, Meetings
from mitsuba_ref.model import reference_of

# t itself is a float64, and cast scales it once more: half a unit in the last place each, and the least float64
# where it is denormal.
OWN_ULPS = 1.0

# Below 2^-1022 numbers are rounded to multiples of 2^-1074, not to a share of themselves, which the error model does
# not know. A dozen such roundings over a slope of no less than 2^-60 put t off by no more than this.
UNDERFLOW = 2.0**-1010


def t_bounds(scene: Scene, packed: Packed, found: Found, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """(n,) bound on |t - exact t| of each hit; inf where float64 cannot resolve it, NaN on a miss.

    The judge's error model with K u of float64: numbers perturbed by 4 units in their last places, times the
    condition of each crossing. Taken at the root that is nearest to t.
    """
    bounds = np.full(len(found.t), np.nan)
    shape = packed.shape_of(found.prim)
    for number in np.unique(shape[found.prim >= 0]):
        rows = np.flatnonzero((shape == number) & (found.prim >= 0))
        part = packed.parts[number]
        model = reference_of(scene.shapes[number]).models[type(part)]
        meet = model.meet_ours or model.meet
        with np.errstate(all="ignore"):
            k = found.prim[rows] - packed.first[number]
            roots = meet(part, k, o[rows], d[rows], KU_OURS)
            bounds[rows] = _at_nearest(found.t[rows], roots)
    with np.errstate(all="ignore"):
        return bounds + OWN_ULPS * np.spacing(np.abs(found.t)) + UNDERFLOW


def _at_nearest(t: np.ndarray, roots: Sequence[Meetings]) -> np.ndarray:
    away = np.array([np.abs(root.t - t) for root in roots])
    errors = np.array([root.t_error for root in roots])
    nearest = np.argmin(np.where(np.isnan(away), np.inf, away), axis=0)
    error = errors[nearest, np.arange(len(t))]
    return np.where(np.isnan(error), np.inf, error)

"""What our picture may not contradict, whatever rounding allows the other side: our own hits."""

import numpy as np

from caster.aovs import BY_NAME
from mitsuba_ref.meeting import KU_OURS
from mitsuba_ref.pair import COMPARED, Pair
from mitsuba_ref.pixels import flat


def coherent(pair: Pair) -> np.ndarray:
    """(n,) bool: on a hit all numbers are finite and depth follows from t; on a miss each AOV says so."""
    hit = np.isfinite(pair.t)
    fine = (pair.ours.hit.ravel() == hit) & np.where(hit, _depth_follows(pair), True)
    for name in COMPARED:
        values = flat(pair.ours, name).reshape(len(hit), -1)
        fine &= np.where(hit, np.isfinite(values).all(axis=1), (values == BY_NAME[name].MISS).all(axis=1))
    return fine


def _depth_follows(pair: Pair) -> np.ndarray:
    """Depth is the distance from the eye: where the ray starts, and t of its lengths; rounded three times."""
    expected = pair.rays.start + pair.t * pair.length
    with np.errstate(invalid="ignore"):
        close: np.ndarray = np.abs(flat(pair.ours, "depth") - expected) <= KU_OURS * np.abs(expected)
    return close

"""What our picture may not contradict, whatever rounding allows the other side: our own hits."""

import numpy as np

from caster.aovs import BY_NAME
from mitsuba_ref.meeting import KU_OURS
from mitsuba_ref.pair import COMPARED, Pair
from mitsuba_ref.pixels import flat


def contradictions(pair: Pair) -> dict[str, np.ndarray]:
    """Where each check's AOV contradicts our hits, (n,) bool: not finite on a hit, a value on a miss, another depth."""
    hit = np.isfinite(pair.t)
    found = {"mask": pair.ours.hit.ravel() != hit}
    for name in COMPARED:
        values = flat(pair.ours, name).reshape(len(hit), -1)
        on_hit, on_miss = np.isfinite(values).all(axis=1), (values == BY_NAME[name].MISS).all(axis=1)
        found[name] = ~np.where(hit, on_hit, on_miss)
    found["depth"] |= hit & ~_depth_follows(pair)
    return found


def _depth_follows(pair: Pair) -> np.ndarray:
    """Depth is the distance from the eye: where the ray starts, and t of its lengths; rounded three times."""
    expected = pair.rays.start + pair.t * pair.length
    with np.errstate(invalid="ignore"):
        close: np.ndarray = np.abs(flat(pair.ours, "depth") - expected) <= KU_OURS * np.abs(expected)
    return close

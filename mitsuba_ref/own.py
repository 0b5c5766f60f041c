"""Our own surface, held to float64: what exact arithmetic does not speak of once the primitive and its t are right."""

import numpy as np

from mitsuba_ref.bounds import Bounds
from mitsuba_ref.pair import Pair
from mitsuba_ref.pixels import apart, flat


def beyond_float64(pair: Pair, bounds: Bounds, point: np.ndarray) -> np.ndarray:
    """(n,) bool: pixels that we hit where a normal or the position is farther from our primitive's than float64 allows.

    point: (n, 3) o + t d. Where float64 does not resolve t, the point and the shading normal, which follow from it,
    are not held to anything; the geometric normal is.
    """
    own = bounds.own
    resolved = np.isfinite(own.t_error)
    beyond = ~(apart(flat(pair.ours, "normal"), own.n) <= own.n_error)
    beyond |= resolved & ~(apart(flat(pair.ours, "shading_normal"), own.sh_n) <= own.sh_error)
    beyond |= resolved & ~(apart(flat(pair.ours, "position"), point) <= own.p_error)
    return beyond & (pair.prim >= 0)

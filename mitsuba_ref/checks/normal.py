"""The geometric normal, as a unit vector: the length of the difference.

Ours against the reference's within float32's bound, and against our own primitive's within float64's. A normal that is
not of unit length, or turned round, differs by far more.
"""

import numpy as np

from mitsuba_ref.pixels import Pixels, apart, flat, share_of_bound

NAME = "normal"


def ratio(pixels: Pixels) -> np.ndarray:
    """The larger of both differences over its bound, where both hit; what we say on a miss has to be nothing."""
    own, at = pixels.bounds.own, pixels.bounds.at
    share = share_of_bound(apart(*pixels.pair(NAME)), at.n_error)
    alone = share_of_bound(apart(flat(pixels.ours, NAME), own.n), own.n_error)
    return pixels.where_both_hit(NAME, np.maximum(share, alone))

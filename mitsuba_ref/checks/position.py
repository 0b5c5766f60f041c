"""The point that was hit: the distance between the two.

The bound is that of t along the ray, and what Mitsuba does to a position afterwards (barycentrics on triangles, a
pull onto the wall of a cylinder); one bound for each kind of primitive. Ours is held to float64's on top.
"""

import numpy as np

from mitsuba_ref.pixels import Pixels, apart, flat, share_of_bound

NAME = "position"


def ratio(pixels: Pixels) -> np.ndarray:
    """The larger of both differences over its bound, where both hit; what we say on a miss has to be nothing."""
    own, at = pixels.bounds.own, pixels.bounds.at
    share = share_of_bound(apart(*pixels.pair(NAME)), at.p_error)
    alone = share_of_bound(apart(flat(pixels.ours, NAME), pixels.point), own.p_error)
    return pixels.where_both_hit(NAME, np.maximum(share, alone))

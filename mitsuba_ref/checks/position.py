"""The point that was hit: the distance between the two.

The bound is that of t along the ray, and what Mitsuba does to a position afterwards (barycentrics on triangles, a
pull onto the wall of a cylinder); one bound for each kind of primitive.
"""

import numpy as np

from mitsuba_ref.pixels import Pixels, apart, share_of_bound

NAME = "position"


def ratio(pixels: Pixels) -> np.ndarray:
    """|ours - reference| / bound where both hit."""
    share = share_of_bound(apart(*pixels.pair("position")), pixels.bounds.at.p_error)
    return pixels.where_both_hit(NAME, share)

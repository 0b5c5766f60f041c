"""The shading normal, as a unit vector: the length of the difference.

A normal that is not of unit length, or turned round, differs by far more than its bound.
"""

import numpy as np

from mitsuba_ref.pixels import Pixels, apart, share_of_bound

NAME = "shading_normal"


def ratio(pixels: Pixels) -> np.ndarray:
    """|ours - reference| / bound where both hit."""
    share = share_of_bound(apart(*pixels.pair("shading_normal")), pixels.bounds.at.sh_error)
    return pixels.where_both_hit(NAME, share)

"""The geometric normal, as a unit vector: the length of the difference.

A normal that is not of unit length, or turned round, differs by far more than its bound.
"""

import numpy as np

from mitsuba_ref.pixels import Pixels, apart, share_of_bound

NAME = "normal"


def ratio(pixels: Pixels) -> np.ndarray:
    """|ours - reference| / bound where both hit."""
    share = share_of_bound(apart(*pixels.pair("normal")), pixels.bounds.at.n_error)
    return pixels.where_both_hit(NAME, share)

"""Our hit lies on the primitive that we say it is on.

All other bounds belong to that primitive, so naming a wrong one would make them worthless. The bound is float64's.
"""

import numpy as np

from mitsuba_ref.error_model.bounds import PixelPairs, error_over_bound

NAME = "on_surface"


def ratio(pixels: PixelPairs) -> np.ndarray:
    """|our t - t of our primitive, worked out anew| / bound where we hit, inf beside it, 0 where we miss."""
    own = pixels.bounds.own
    with np.errstate(invalid="ignore"):
        error = np.abs(pixels.t_ours - own.t)
    share = np.where(own.possible, error_over_bound(error, own.t_error), np.inf)
    return np.where(pixels.hits[0], share, 0.0)

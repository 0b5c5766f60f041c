"""Our hit lies on the primitive that we say it is on.

All other bounds belong to that primitive, so naming a wrong one would make them worthless. The bound is float64's.
"""

import numpy as np

from mitsuba_ref.pixels import Pixels, share_of_bound

NAME = "on_surface"


def ratio(pixels: Pixels) -> np.ndarray:
    """|our t - t of our primitive, worked out anew| / bound where we hit, inf beside it, 0 where we miss."""
    with np.errstate(invalid="ignore"):
        error = np.abs(pixels.t_ours - pixels.bounds.own.t)
    share = share_of_bound(error, pixels.bounds.own.t_error)
    return np.where(pixels.hits[0], np.where(pixels.bounds.own.possible, share, np.inf), 0.0)

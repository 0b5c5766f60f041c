"""Our hit lies on the primitive that we say it is on.

All other bounds belong to that primitive, so naming a wrong one would make them worthless. The bound is float64's.
"""

import numpy as np

from mitsuba_ref.pixels import Pixels, share_of_bound

NAME = "on_surface"


def ratio(pixels: Pixels) -> np.ndarray:
    """|our t - t of our primitive, worked out anew| / bound where we hit, 0 elsewhere."""
    with np.errstate(invalid="ignore"):
        error = np.abs(pixels.t_ours - pixels.bounds.own.t)
    return np.where(pixels.hits[0], share_of_bound(error, pixels.bounds.own.t_error), 0.0)

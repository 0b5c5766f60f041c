"""The geometric normal, as a unit vector: the length of the difference.

Ours against the reference's within float32's bound, and against our own primitive's within float64's. A normal that is
not of unit length, or turned round, differs by far more.
"""

import numpy as np

from mitsuba_ref.pixels import Pixels

NAME = "normal"


def ratio(pixels: Pixels) -> np.ndarray:
    """(n,) the larger of both differences over its bound."""
    own, at = pixels.bounds.own, pixels.bounds.at
    return pixels.held_twice(NAME, at.n_error, own.n, own.n_error)

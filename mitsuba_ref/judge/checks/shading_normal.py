"""The shading normal, as a unit vector: the length of the difference.

Ours against the reference's within float32's bound, and against our own primitive's within float64's. A normal that is
not of unit length, or turned round, differs by far more.
"""

import numpy as np

from mitsuba_ref.error_model.bounds import PixelPairs

NAME = "shading_normal"


def bound(pixels: PixelPairs) -> np.ndarray:
    """(n,) how far the reference's may be from ours."""
    return pixels.bounds.at.sh_error


def ratio(pixels: PixelPairs) -> np.ndarray:
    """(n,) the larger of both differences over its bound."""
    own = pixels.bounds.own
    return pixels.larger_error_ratio(NAME, bound(pixels), own.sh_n, own.sh_error)

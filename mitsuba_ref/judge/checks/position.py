"""The point that was hit: the distance between the two.

The bound is that of t along the ray, and what Mitsuba does to a position afterwards (barycentrics on triangles, a
pull onto the wall of a cylinder); one bound for each kind of primitive. Ours is held to float64's on top.
"""

import numpy as np

from mitsuba_ref.error_model.bounds import PixelPairs

NAME = "position"


def bound(pixels: PixelPairs) -> np.ndarray:
    """(n,) how far the reference's may be from ours."""
    return pixels.bounds.at.p_error


def ratio(pixels: PixelPairs) -> np.ndarray:
    """(n,) the larger of both differences over its bound."""
    own = pixels.bounds.own
    return pixels.larger_error_ratio(NAME, bound(pixels), pixels.point, own.p_error)

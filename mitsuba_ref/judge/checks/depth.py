"""Depth: the distance from the eye along the ray.

The bound is that of t at the primitive hit, in scene units, and one rounding of our own sum of start and t |d|.
"""

import numpy as np

from mitsuba_ref.error_model.bounds import PixelPairs, error_over_bound
from mitsuba_ref.error_model.intersections import KU_OURS

NAME = "depth"


def bound(pixels: PixelPairs) -> np.ndarray:
    """(n,) how far the reference's may be from ours, in scene units."""
    ours, _ = pixels.pair("depth")
    with np.errstate(invalid="ignore"):
        return pixels.bounds.at.t_error * pixels.length + KU_OURS * np.abs(ours)


def ratio(pixels: PixelPairs) -> np.ndarray:
    """|ours - reference| / bound where both hit."""
    ours, reference = pixels.pair("depth")
    with np.errstate(invalid="ignore"):
        error = np.abs(ours - reference)
    return np.where(pixels.both_hit, error_over_bound(error, bound(pixels)), 0.0)

"""Hit or miss: equal, or not."""

import numpy as np

from mitsuba_ref.error_model.bounds import PixelPairs

NAME = "mask"


def ratio(pixels: PixelPairs) -> np.ndarray:
    """0 where both hit or both miss, else inf: the bracket has to allow it."""
    ours, reference = pixels.hits
    return np.where(ours == reference, 0.0, np.inf)

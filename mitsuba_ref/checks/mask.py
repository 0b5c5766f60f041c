"""Hit or miss: equal, or not."""

import numpy as np

from mitsuba_ref.pixels import Pixels

NAME = "mask"


def ratio(pixels: Pixels) -> np.ndarray:
    """0 where both hit or both miss, else inf: the bracket has to allow it."""
    ours, reference = pixels.hits
    return np.where(ours == reference, 0.0, np.inf)

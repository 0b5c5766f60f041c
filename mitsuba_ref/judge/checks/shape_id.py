"""Which shape was hit: the same, or not."""

import numpy as np

from mitsuba_ref.error_model.bounds import PixelPairs

NAME = "shape_id"


def ratio(pixels: PixelPairs) -> np.ndarray:
    """0 where both name the same shape, else inf: the bracket has to allow it."""
    ours, reference = pixels.pair("shape_id")
    return np.where(ours == reference, 0.0, np.inf)

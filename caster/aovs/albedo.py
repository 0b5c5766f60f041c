"""The diffuse reflectance of the material that was hit."""

import numpy as np

from caster.rendering.view import View

NAME, CHANNELS, MISS = "albedo", ("albedo.R", "albedo.G", "albedo.B"), 0.0


def evaluate(view: View) -> np.ndarray:
    """(n, 3) float64 in [0, 1], 0 on a miss."""
    return view.reflectance

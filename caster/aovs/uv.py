"""Surface coordinates; what they mean is said at each shape's `surface`."""

import numpy as np

from caster.rendering.view import View

NAME, CHANNELS, MISS = "uv", ("uv.U", "uv.V"), 0.0


def evaluate(view: View) -> np.ndarray:
    """(n, 2) float64, 0 on a miss."""
    return view.surfaces.uv

"""Where the ray meets the surface, in world space."""

import numpy as np

from caster.rendering.view import View

NAME, CHANNELS, MISS = "position", ("position.X", "position.Y", "position.Z"), 0.0


def evaluate(view: View) -> np.ndarray:
    """(n, 3) float64, 0 on a miss."""
    return view.surfaces.p

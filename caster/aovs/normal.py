"""The geometric normal: across the surface itself, outwards; never turned towards the ray."""

import numpy as np

from caster.rendering.view import View

NAME, CHANNELS, MISS = "normal", ("normal.X", "normal.Y", "normal.Z"), 0.0


def evaluate(view: View) -> np.ndarray:
    """(n, 3) float64, unit length, 0 on a miss."""
    return view.surfaces.n

"""How far away: the distance from the eye along the ray, in scene units."""

import numpy as np

from caster.rendering.view import View, length

NAME, CHANNELS, MISS = "depth", ("depth.Z",), np.inf


def evaluate(view: View) -> np.ndarray:
    """(n,) float64, inf on a miss. Measured from the eye also where a near plane hides what is closer."""
    return view.start + view.nearest.t * length(view.rays.d)

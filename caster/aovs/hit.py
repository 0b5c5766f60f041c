"""The mask: 1 where the ray met something."""

import numpy as np

from caster.rendering.view import View

NAME, CHANNELS, MISS = "hit", ("A",), 0.0


def evaluate(view: View) -> np.ndarray:
    """(n,) float64, 0 or 1."""
    return view.hit.astype(np.float64)

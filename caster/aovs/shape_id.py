"""Which shape, counted from 0 in the order of the scene."""

import numpy as np

from caster.rendering.view import View

NAME, CHANNELS, MISS = "shape_id", ("id.shape",), -1


def evaluate(view: View) -> np.ndarray:
    """(n,) int32, -1 on a miss (0xFFFFFFFF in a file)."""
    return view.shape_id

"""Which primitive of the shape: the triangle of a mesh, 0 for a shape of one piece."""

import numpy as np

from caster.rendering.view import View

NAME, CHANNELS, MISS = "prim_id", ("id.prim",), -1


def evaluate(view: View) -> np.ndarray:
    """(n,) int32, -1 on a miss (0xFFFFFFFF in a file)."""
    return view.prim_id

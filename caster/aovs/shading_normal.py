"""The shading normal: interpolated between a mesh's vertex normals, elsewhere the geometric one."""

import numpy as np

from caster.rendering.view import View

NAME, MISS = "shading_normal", 0.0
CHANNELS = ("shading_normal.X", "shading_normal.Y", "shading_normal.Z")


def evaluate(view: View) -> np.ndarray:
    """(n, 3) float64, unit length, 0 on a miss."""
    return view.surfaces.sh_n

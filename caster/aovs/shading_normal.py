"""Shading normal: interpolated between a mesh's vertex normals, elsewhere the geometric one."""

import numpy as np

from caster.kernels.protocol import Vec3
from caster.kernels.surface.per_hit import Hit

NAME, DTYPE, MISS = "shading_normal", np.float64, 0.0
CHANNELS = ("shading_normal.X", "shading_normal.Y", "shading_normal.Z")
NEEDS = ("shading_normal",)
PREVIEW = "direction"


def evaluate(hit: Hit) -> Vec3:
    return hit.shading_normal

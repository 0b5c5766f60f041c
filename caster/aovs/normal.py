"""Geometric normal: unit length, outwards, never turned towards the ray."""

import numpy as np

from caster.kernels.protocol import Vec3
from caster.kernels.surface.per_hit import Hit

NAME, CHANNELS, DTYPE, MISS = "normal", ("normal.X", "normal.Y", "normal.Z"), np.float64, 0.0
NEEDS = ("normal",)
PREVIEW = "direction"


def evaluate(hit: Hit) -> Vec3:
    return hit.normal

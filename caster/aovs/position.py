"""Point of the surface that the ray hits, in world space."""

import numpy as np

from caster.kernels.protocol import Vec3
from caster.kernels.surface.per_hit import Hit

NAME, CHANNELS, DTYPE, MISS = "position", ("position.X", "position.Y", "position.Z"), np.float64, 0.0
NEEDS = ("position",)
PREVIEW = "position"


def evaluate(hit: Hit) -> Vec3:
    return hit.position

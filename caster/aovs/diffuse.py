"""Lambert shading: radiance reflected of each light, with hard shadows, and of ambient light."""

import numpy as np

from caster.kernels.protocol import Vec3
from caster.kernels.surface.per_hit import Hit

NAME, CHANNELS, DTYPE, MISS = "diffuse", ("R", "G", "B"), np.float64, 0.0
NEEDS = ("radiance",)
PREVIEW = "radiance"


def evaluate(hit: Hit) -> Vec3:
    return hit.radiance

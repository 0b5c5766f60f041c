"""Surface coordinates; each shape's `surface` defines them."""

import numpy as np

from caster.kernels.surface.per_hit import Hit

NAME, CHANNELS, DTYPE, MISS = "uv", ("uv.U", "uv.V"), np.float64, 0.0
NEEDS = ("uv",)
PREVIEW = "uv"


def evaluate(hit: Hit) -> tuple[float, float]:
    return hit.uv

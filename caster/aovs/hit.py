"""Mask: 1 where the ray hits something."""

import numpy as np

from caster.kernels.surface.per_hit import Hit

NAME, CHANNELS, DTYPE, MISS = "hit", ("A",), np.float64, 0.0
NEEDS = ()
PREVIEW = "mask"


def evaluate(hit: Hit) -> float:
    return 1.0

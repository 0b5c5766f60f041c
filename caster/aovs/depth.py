"""Distance from the eye along the ray, in scene units; counted from the eye also where a near plane hides a part."""

import math

import numpy as np

from caster.kernels.surface.per_hit import Hit, length

NAME, CHANNELS, DTYPE, MISS = "depth", ("depth.Z",), np.float64, math.inf
NEEDS = ()
PREVIEW = "depth"


def evaluate(hit: Hit) -> float:
    return hit.start + hit.t * length(hit.d)

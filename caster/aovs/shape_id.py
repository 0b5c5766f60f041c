"""Index of the shape in the scene, from 0."""

import numpy as np

from caster.kernels.surface.per_hit import Hit

NAME, CHANNELS, DTYPE, MISS = "shape_id", ("id.shape",), np.int32, -1  # 0xFFFFFFFF in a file
NEEDS = ("shape_id",)
PREVIEW = "ids"


def evaluate(hit: Hit) -> int:
    return hit.shape_id

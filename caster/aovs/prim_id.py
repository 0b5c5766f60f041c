"""Index of the primitive within its shape: the triangle of a mesh, 0 for a shape of one primitive."""

import numpy as np

from caster.kernels.surface.per_hit import Hit

NAME, CHANNELS, DTYPE, MISS = "prim_id", ("id.prim",), np.int32, -1  # 0xFFFFFFFF in a file
NEEDS = ("prim_id",)
PREVIEW = "ids"


def evaluate(hit: Hit) -> int:
    return hit.prim_id

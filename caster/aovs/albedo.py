"""Diffuse reflectance of the material, in [0, 1]."""

import numpy as np

from caster.kernels.protocol import Vec3
from caster.kernels.surface.per_hit import Hit

NAME, CHANNELS, DTYPE, MISS = "albedo", ("albedo.R", "albedo.G", "albedo.B"), np.float64, 0.0
NEEDS = ("albedo",)
PREVIEW = "reflectance"


def evaluate(hit: Hit) -> Vec3:
    return hit.albedo

"""Adversarial rays of `mitsuba_ref.hard` at a packed scene, by the way they are aimed."""

import numpy as np

from caster.geometry.packing import Packed
from caster.kernels.nearest import Rays
from caster.rendering.hits import scaled_rays
from mitsuba_ref.hard import rays as aims
from mitsuba_ref.hard.rays import Frame, Targets, aimed_rays

Rng = np.random.Generator
OD = tuple[np.ndarray, np.ndarray]

FAMILIES = {
    "at features": aims.at_features,
    "tangents": aims.tangents,
    "through two points": aims.through_two_points,
    "between two points": aims.between_two_points,
    "from surface": aims.from_surface,
    "along axes": aims.along_axes,
    "anywhere": aims.anywhere,
    "from afar": aims.from_afar,
    "of any length": aims.of_any_length(aims.at_features, 100),
}
SHORT = 1e-100  # directions below are scaled, as `cast` does before it calls a kernel


def hard_rays(packed: Packed, rng: Rng, count: int) -> dict[str, OD]:
    """`count` rays of every family; none is zero, not finite, or so short that squares vanish."""
    points = Targets(packed, rng).points(50, "inside").p
    targets = Targets(packed, rng, Frame(float(np.median(np.ptp(points, axis=0))), np.median(points, axis=0)))
    found = {}
    for name, aim in FAMILIES.items():
        rays = Rays(*aimed_rays(targets, count, [aim]))
        short = np.abs(rays.d).max(axis=1, keepdims=True) < SHORT
        found[name] = rays.o, np.where(short, scaled_rays(rays)[0].d, rays.d)
    return found

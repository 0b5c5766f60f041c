"""Near-tangency: rays that pass a sphere's silhouette, just inside and just outside."""

import numpy as np

from mitsuba_ref.stress import sphere_and_mesh
from mitsuba_ref.stress.aiming import Rays, across, balanced, directions, impact, part_of, towards
from mitsuba_ref.stress.family import Family, Rng, Setting

DISTANCE = 5.0  # radii
GAPS = (1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
WITHIN = (0.3, 3.0)  # of the gap aimed at: rays that rounding moved out of it are left out
CANDIDATES = 400  # for each ray that is kept; at the narrowest gap one in fifty stays in it


def make(rng: Rng, gap: float, count: int) -> Setting:
    scene = sphere_and_mesh.ball(1.0, rng.normal(scale=0.3, size=3))
    part = part_of(scene)
    center, r = part.center[0], part.radius[0]
    o, d = candidates(rng, gap, (center, r), CANDIDATES * count)
    off = impact(center, o.astype(np.float64), d.astype(np.float64)) / r - 1.0
    kept = (np.abs(off) >= WITHIN[0] * gap) & (np.abs(off) <= WITHIN[1] * gap)
    return Setting(gap, scene, *balanced((o[kept], d[kept]), off[kept] < 0.0, count))


def candidates(rng: Rng, gap: float, ball: tuple[np.ndarray, float], many: int) -> Rays:
    """Rays that pass the centre at r (1 - gap) or r (1 + gap)."""
    center, r = ball
    v = directions(rng, many)
    beside = center + r * (1.0 + gap * rng.choice([-1.0, 1.0], (many, 1))) * across(rng, v)
    return towards(beside - DISTANCE * v, beside)


FAMILY = Family(
    "tangency",
    "how nearly rays touch a sphere's silhouette",
    "distance from the silhouette over radius",
    GAPS,
    GAPS[-1],
    make,
)

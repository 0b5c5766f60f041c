"""Scene scale: the same ball, larger and smaller than float32 products bear."""

import numpy as np

from mitsuba_ref.stress import sphere_and_mesh
from mitsuba_ref.stress.family import Family, Rng, Setting

DISTANCE = 5.0  # radii


def of_mesh(rng: Rng, scale: float, count: int) -> Setting:
    center = scale * rng.normal(scale=0.3, size=3)
    scene = sphere_and_mesh.mesh(rng, scale, center)
    return sphere_and_mesh.seen(rng, scale, scene, (center, scale, DISTANCE * scale), count)


def of_sphere(rng: Rng, scale: float, count: int) -> Setting:
    center = scale * rng.normal(scale=0.3, size=3)
    scene = sphere_and_mesh.ball(scale, center)
    return sphere_and_mesh.seen(rng, scale, scene, (center, scale, DISTANCE * scale), count)


def decades(*exponents: int) -> tuple[float, ...]:
    return tuple(float(np.float64(f"1e{exponent}")) for exponent in exponents)


MESH = Family(
    "scale-mesh",
    "the size of a whole scene of triangles",
    "radius of the ball, scene units",
    decades(-20, -16, -14, -13, -12, -11, -9, -6, -3, 0, 3, 6, 9, 11, 12, 13, 14, 16, 18),
    1.0,
    of_mesh,
)
SPHERE = Family(
    "scale-sphere",
    "the size of a whole scene of a sphere",
    "radius of the sphere, scene units",
    decades(-30, -24, -20, -19, -17, -15, -12, -8, -4, 0, 4, 8, 12, 15, 17, 18, 19, 20, 24, 30),
    1.0,
    of_sphere,
)

"""Ray length: the same rays with directions far from unit length."""

from dataclasses import replace

import numpy as np

from mitsuba_ref.stress import sphere_and_mesh
from mitsuba_ref.stress.family import Family, Rng, Setting
from mitsuba_ref.stress.scale import DISTANCE, decades

LENGTHS = decades(-36, -30, -25, -20, -15, -10, -5, -3, 0, 3, 5, 10, 15, 18, 20, 25, 30, 36)


def stretched(setting: Setting, length: float) -> Setting:
    """The same directions, `length` times as long; rounded to float32 once more, which turns them a little."""
    return replace(setting, x=length, d=(setting.d.astype(np.float64) * length).astype(np.float32))


def of_mesh(rng: Rng, length: float, count: int) -> Setting:
    center = rng.normal(scale=0.3, size=3)
    scene = sphere_and_mesh.mesh(rng, 1.0, center)
    return stretched(sphere_and_mesh.seen(rng, length, scene, (center, 1.0, DISTANCE), count), length)


def of_sphere(rng: Rng, length: float, count: int) -> Setting:
    center = rng.normal(scale=0.3, size=3)
    scene = sphere_and_mesh.ball(1.0, center)
    return stretched(sphere_and_mesh.seen(rng, length, scene, (center, 1.0, DISTANCE), count), length)


MESH = Family("length-mesh", "how long d is, at triangles", "length of d", LENGTHS, 1.0, of_mesh)
SPHERE = Family("length-sphere", "how long d is, at a sphere", "length of d", LENGTHS, 1.0, of_sphere)

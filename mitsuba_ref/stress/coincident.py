"""Coincident surfaces: two that lie closer and closer together, at last exactly on each other."""

import numpy as np

from caster.shapes import Sphere, Triangle
from mitsuba_ref.stress.aiming import (
    Rays,
    chosen,
    crosses_triangles,
    directions,
    part_of,
    passes_ball,
    scene_of,
    towards,
)
from mitsuba_ref.stress.family import Family, Rng, Setting

DISTANCE = 5.0  # sizes
GAPS = (0.0, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
STEEPEST = 0.3  # least |cos| between rays and the normal


def of_triangles(rng: Rng, gap: float, count: int) -> Setting:
    """A large triangle and its copy, moved along the normal; the copy is the one in front for half of the rays."""
    corners = np.array([[1.0, 0.1, 0.2], [-0.6, 0.8, -0.3], [-0.4, -0.9, 0.1]]) + rng.normal(
        scale=0.1, size=(3, 3)
    )
    n = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    n /= np.linalg.norm(n)
    scene = scene_of(Triangle(vertices=corners), Triangle(vertices=corners + gap * n))

    def candidates(many: int) -> Rays:
        v = directions(rng, many)
        v[np.abs(v @ n) < STEEPEST] = n
        aim = (rng.dirichlet(np.ones(3), many) * 1.4 - 0.4 / 3.0) @ corners
        return towards(aim + DISTANCE * v, aim)

    parts = [part_of(scene, i) for i in (0, 1)]
    hits = crosses_triangles(np.concatenate([part.vertices[part.faces] for part in parts]))
    return Setting(gap, scene, *chosen(candidates, hits, count))


def of_spheres(rng: Rng, gap: float, count: int) -> Setting:
    """Two concentric spheres; the second is the larger one."""
    center = rng.normal(scale=0.3, size=3)
    scene = scene_of(Sphere(center=center, radius=1.0), Sphere(center=center, radius=1.0 + gap))

    def candidates(many: int) -> Rays:
        aim = center + 1.2 * np.sqrt(rng.random((many, 1))) * directions(rng, many)
        return towards(center + DISTANCE * directions(rng, many), aim)

    return Setting(gap, scene, *chosen(candidates, passes_ball(center, 1.0 + gap), count))


TRIANGLES = Family(
    "coincident-triangles",
    "how close two triangles lie to each other",
    "gap over size",
    GAPS,
    GAPS[-1],
    of_triangles,
)
SPHERES = Family(
    "coincident-spheres",
    "how close two concentric spheres lie to each other",
    "gap over radius",
    GAPS,
    GAPS[-1],
    of_spheres,
)

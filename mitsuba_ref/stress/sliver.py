"""Sliver aspect: a triangle that gets thinner and thinner."""

import numpy as np

from caster.shapes import Triangle
from mitsuba_ref.stress.aiming import (
    Rays,
    chosen,
    crosses_triangles,
    directions,
    part_of,
    scene_of,
    towards,
    turn,
)
from mitsuba_ref.stress.family import Family, Rng, Setting

DISTANCE = 5.0  # lengths of the long side
ASPECTS = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)
STEEPEST = 0.3  # least |cos| between rays and the normal


def make(rng: Rng, aspect: float, count: int) -> Setting:
    """Height over base: a base of 1, turned, so that rounding its corners bends it in all directions."""
    corners = np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [rng.uniform(-0.2, 0.2), aspect, 0.0]])
    scene = scene_of(Triangle(vertices=corners, to_world=[turn(rng)]))
    part = part_of(scene)
    n = np.cross(part.vertices[1] - part.vertices[0], part.vertices[2] - part.vertices[0])
    n /= np.linalg.norm(n)

    def candidates(many: int) -> Rays:
        v = directions(rng, many)
        v[np.abs(v @ n) < STEEPEST] = n
        aim = (rng.dirichlet(np.ones(3), many) * 1.4 - 0.4 / 3.0) @ part.vertices
        return towards(aim + DISTANCE * v, aim)

    hits = crosses_triangles(part.vertices[part.faces])
    return Setting(aspect, scene, *chosen(candidates, hits, count))


FAMILY = Family(
    "sliver",
    "how thin a triangle is",
    "height over base",
    ASPECTS,
    ASPECTS[-1],
    make,
)

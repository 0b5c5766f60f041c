"""What the sweeps of scale, offset and distance share: one ball, of triangles or of one equation, seen from afar."""

import numpy as np

from caster.scene import Scene
from caster.shapes import Icosphere, Sphere
from mitsuba_ref.stress.aiming import (
    chosen,
    crosses_triangles,
    directions,
    part_of,
    passes_ball,
    scene_of,
    towards,
    turn,
)
from mitsuba_ref.stress.family import Rng, Setting

AIMED = 1.4  # radius around the middle that rays are aimed at, in radii: about half of them hit


def ball(radius: float, center: np.ndarray) -> Scene:
    return scene_of(Sphere(center=center, radius=radius))


def mesh(rng: Rng, radius: float, center: np.ndarray) -> Scene:
    """80 triangles, turned."""
    place = [{"scale": radius}, turn(rng), {"translate": center}]
    return scene_of(Icosphere(subdivisions=1, face_normals=True, to_world=place))


def seen(rng: Rng, x: float, scene: Scene, view: tuple[np.ndarray, float, float], count: int) -> Setting:
    """Rays from all around to a ball, view = (its center, its radius, their distance)."""
    center, radius, distance = view
    part = part_of(scene)

    def make(many: int) -> tuple[np.ndarray, np.ndarray]:
        around = directions(rng, many)
        aim = center + AIMED * radius * np.sqrt(rng.random((many, 1))) * directions(rng, many)
        return towards(center + distance * around, aim)

    if hasattr(part, "radius"):
        hits = passes_ball(part.center[0], part.radius[0])
    else:
        hits = crosses_triangles(part.vertices[part.faces])
    return Setting(x, scene, *chosen(make, hits, count))

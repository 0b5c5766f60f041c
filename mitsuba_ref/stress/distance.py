"""Distance over radius: rays from ever farther away."""

import numpy as np

from caster.shapes import Triangle
from mitsuba_ref.stress import sphere_and_mesh
from mitsuba_ref.stress.aiming import chosen, crosses_triangles, directions, part_of, scene_of, towards
from mitsuba_ref.stress.family import Family, Rng, Setting

DISTANCES = (1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8)
STEEPEST = 0.3  # least |cos| between rays and the triangle's normal: grazing rays are another family


def of_triangle(rng: Rng, distance: float, count: int) -> Setting:
    corners = np.array([[1.0, 0.1, 0.0], [-0.6, 0.8, 0.1], [-0.4, -0.9, -0.1]]) + rng.normal(
        scale=0.1, size=(3, 3)
    )
    scene = scene_of(Triangle(vertices=corners))
    part = part_of(scene)
    n = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    n /= np.linalg.norm(n)

    def make(many: int) -> tuple[np.ndarray, np.ndarray]:
        v = directions(rng, many)
        v[np.abs(v @ n) < STEEPEST] = n
        weights = rng.dirichlet(np.ones(3), many) * 1.4 - 0.4 / 3.0
        aim = weights @ part.vertices
        return towards(aim + distance * v, aim)

    return Setting(distance, scene, *chosen(make, crosses_triangles(part.vertices[part.faces]), count))


def of_sphere(rng: Rng, distance: float, count: int) -> Setting:
    center = rng.normal(scale=0.3, size=3)
    return sphere_and_mesh.seen(
        rng, distance, sphere_and_mesh.ball(1.0, center), (center, 1.0, distance), count
    )


TRIANGLE = Family(
    "distance-triangle",
    "how far rays come to a triangle",
    "distance over size",
    DISTANCES,
    DISTANCES[0],
    of_triangle,
)
SPHERE = Family(
    "distance-sphere",
    "how far rays come to a sphere",
    "distance over radius",
    DISTANCES,
    DISTANCES[0],
    of_sphere,
)

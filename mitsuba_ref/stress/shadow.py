"""Shadow rays: they start on the surface, or ever closer to it, and leave it or go through the inside."""

import numpy as np

from caster.scene import Scene
from mitsuba_ref.stress import sphere_and_mesh
from mitsuba_ref.stress.aiming import directions, float32, part_of, unit
from mitsuba_ref.stress.family import Family, Rng, Setting

OFFSETS = (0.0, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
ERROR = "error of t over radius"


def leaving(rng: Rng, offset: float, scene: Scene, surface: tuple[np.ndarray, np.ndarray]) -> Setting:
    """Rays from points p off the surface along n: half to the outside, half inwards. surface = (p, n), (m, 3) each."""
    p, n = surface
    d = directions(rng, len(p))
    outwards = np.where(np.arange(len(p)) % 2 == 0, 1.0, -1.0)
    d *= (np.sign(np.einsum("ij,ij->i", d, n)) * outwards)[:, None]
    return Setting(offset, scene, float32(p + offset * n), float32(d), unit=1.0)


def of_sphere(rng: Rng, offset: float, count: int) -> Setting:
    scene = sphere_and_mesh.ball(1.0, rng.normal(scale=0.3, size=3))
    n = directions(rng, count)
    return leaving(rng, offset, scene, (part_of(scene).center[0] + part_of(scene).radius[0] * n, n))


def of_mesh(rng: Rng, offset: float, count: int) -> Setting:
    scene = sphere_and_mesh.mesh(rng, 1.0, rng.normal(scale=0.3, size=3))
    part = part_of(scene)
    corners = part.vertices[part.faces[rng.integers(len(part.faces), size=count)]]
    p = np.einsum("ij,ijk->ik", rng.dirichlet(np.ones(3), count), corners)
    n = unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    return leaving(rng, offset, scene, (p, n))


SPHERE = Family(
    "shadow-sphere",
    "how far off a sphere the rays start that leave it",
    "offset of the start over radius",
    OFFSETS,
    OFFSETS[-1],
    of_sphere,
    error=ERROR,
)
MESH = Family(
    "shadow-mesh",
    "how far off a ball of triangles the rays start that leave it",
    "offset of the start over radius",
    OFFSETS,
    OFFSETS[-1],
    of_mesh,
    error=ERROR,
)

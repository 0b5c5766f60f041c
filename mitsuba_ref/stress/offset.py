"""Offset from the origin: coordinates that leave less and less of float32 to the shape."""

import numpy as np

from mitsuba_ref.stress import sphere_and_mesh
from mitsuba_ref.stress.aiming import directions
from mitsuba_ref.stress.family import Family, Rng, Setting

DISTANCE = 5.0  # radii


def middle(rng: Rng, offset: float) -> np.ndarray:
    """A float32 point at about this distance from the origin."""
    return (offset * directions(rng, 1)[0]).astype(np.float32).astype(np.float64)


def of_mesh(rng: Rng, offset: float, count: int) -> Setting:
    center = middle(rng, offset)
    scene = sphere_and_mesh.mesh(rng, 1.0, center)
    return sphere_and_mesh.seen(rng, offset, scene, (center, 1.0, DISTANCE), count)


def of_sphere(rng: Rng, offset: float, count: int) -> Setting:
    center = middle(rng, offset)
    return sphere_and_mesh.seen(
        rng, offset, sphere_and_mesh.ball(1.0, center), (center, 1.0, DISTANCE), count
    )


MESH = Family(
    "offset-mesh",
    "how far from the origin a ball of triangles stands",
    "offset over radius",
    (1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 3e6, 1e7),
    1.0,
    of_mesh,
)
SPHERE = Family(
    "offset-sphere",
    "how far from the origin a sphere stands",
    "offset over radius",
    (1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7),
    1.0,
    of_sphere,
)

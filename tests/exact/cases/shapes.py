"""Shapes to aim at: of every kind of the registry at any size and place, and some whose surface points are exact."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from aimed_rays import Spots, decades, direction, spots

from caster import (
    Cube,
    Cylinder,
    Disk,
    EllipsoidCloud,
    Heightfield,
    Icosphere,
    LinearCurve,
    Mesh,
    Plane,
    Rectangle,
    Scene,
    Sphere,
    SphereCloud,
    Teapot,
    Torus,
    Triangle,
)
from caster.description.fields import Shape

Rng = np.random.Generator


def mesh_of(vertices: Any, faces: Any) -> Mesh:
    """Triangles from arrays (v, 3) and (n, 3), flat."""
    return Mesh(np.reshape(vertices, (-1, 3)), faces, face_normals=True)


def turn(rng: Rng) -> dict[str, Any]:
    return {"rotate": {"axis": direction(rng, 1)[0], "degrees": rng.uniform(10.0, 350.0)}}


def place(rng: Rng, size: float, middle: Any, stretch: Any = 1.0) -> list[dict[str, Any]]:
    """Steps that stretch, turn and move."""
    return [{"scale": size * np.asarray(stretch, float)}, turn(rng), {"translate": np.asarray(middle, float)}]


def strewn(rng: Rng, count: int = 6) -> Mesh:
    """A mesh file of triangles that do not meet."""
    corners = rng.uniform(-0.7, 0.7, (count, 1, 3)) + rng.normal(0.0, 0.3, (count, 3, 3))
    return mesh_of(corners, np.arange(3 * count).reshape(-1, 3))


ROUND = ("sphere", "ellipsoid", "cylinder", "elliptic cylinder")
CLOSED = ("sphere", "ellipsoid", "cube", "icosphere", "torus")


def shape_of(kind: str, rng: Rng, size: float = 1.0, middle: Any = (0.0, 0.0, 0.0), stretch: Any = 1.0) -> Shape:
    """A shape about `size` large around `middle`, turned; stretched, where it can be, along its own axes."""
    steps = place(rng, size, middle, stretch)
    if kind == "mesh":
        return strewn(rng).model_copy(update={"to_world": steps})
    if kind == "plane":
        return Plane(normal=direction(rng, 1)[0], point=np.asarray(middle, float) + size * rng.normal(size=3))
    if kind == "triangle":
        return Triangle(vertices=rng.uniform(-1.0, 1.0, (3, 3)), to_world=steps)
    if kind == "ellipsoid":
        return Sphere(to_world=place(rng, size, middle, np.asarray(stretch) * np.array([1.0, 0.5, 0.25])))
    if kind == "elliptic cylinder":
        return Cylinder(to_world=place(rng, size, middle, np.asarray(stretch) * np.array([1.0, 0.4, 1.5])))
    return PLAIN[kind](steps)


CLOUD_CENTERS, CLOUD_RADII = ((-0.5, 0.1, 0.0), (0.6, -0.3, 0.2), (0.1, 0.5, -0.4)), (0.4, 0.3, 0.5)
PLAIN = {
    "sphere": lambda steps: Sphere(to_world=steps),
    "spheres": lambda steps: SphereCloud(centers=CLOUD_CENTERS, radii=CLOUD_RADII, to_world=steps),
    "ellipsoids": lambda steps: EllipsoidCloud(
        centers=CLOUD_CENTERS, scales=((0.4, 0.3, 0.5),) * 3, quaternions=((0.1, 0.2, 0.3, 0.9),) * 3, to_world=steps
    ),
    "linear_curve": lambda steps: LinearCurve(points=CLOUD_CENTERS, radii=CLOUD_RADII, to_world=steps),
    "rectangle": lambda steps: Rectangle(to_world=steps),
    "disk": lambda steps: Disk(to_world=steps),
    "cube": lambda steps: Cube(to_world=steps),
    "cylinder": lambda steps: Cylinder(radius=0.5, to_world=steps),
    "icosphere": lambda steps: Icosphere(subdivisions=1, to_world=steps),
    "torus": lambda steps: Torus(segments=9, sides=5, to_world=steps),
    "heightfield": lambda steps: Heightfield(resolution=5, to_world=steps),
    "teapot": lambda steps: Teapot(subdivisions=1, to_world=steps),
}
KINDS = (
    "sphere",
    "ellipsoid",
    "plane",
    "triangle",
    "mesh",
    "cylinder",
    "elliptic cylinder",
    *sorted(PLAIN.keys() - {"sphere", "cylinder"}),
)


def every_kind(rng: Rng, size: float = 1.0, middle: Any = (0.0, 0.0, 0.0)) -> Iterator[tuple[str, Shape]]:
    for kind in KINDS:
        yield kind, shape_of(kind, rng, size, middle)


def spots_on(part: Any, rng: Rng, count: int, edges: float, size: float) -> Spots:
    """Points of one shape's packed arrays and normals there; of a plane, within a few sizes of its point."""
    if not hasattr(part, "faces") and hasattr(part, "normal"):
        n = part.normal[0] / np.linalg.norm(part.normal[0])
        across = np.cross(n, rng.normal(size=(count, 3)))
        return Spots(part.point[0] + size * across, np.tile(n, (count, 1)))
    with np.errstate(all="ignore"):
        return spots(part, rng, count, edges)


def across(rng: Rng, n: np.ndarray) -> np.ndarray:
    """Unit vectors in any direction across each of n (m, 3)."""
    v = np.cross(n, direction(rng, len(n)))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


class Aim(NamedTuple):
    """From how far, in sizes, how steeply, and how often at an edge, a corner or a rim."""

    distances: tuple[float, float] = (2.0, 20.0)
    slopes: tuple[float, float] = (0.05, 1.0)
    edges: float = 0.25


def rays_at(
    make: Any, scene: Scene, count: int, size: float = 1.0, aim: Aim | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Rays (n, 3), (n, 3) in the maker's precision, d of about unit length, at points of the only shape."""
    rng, aim = make.rng, aim or Aim()
    p, n = spots_on(scene.derived["packed"].parts[0], rng, count, aim.edges, size)
    n = np.where(np.isfinite(n).all(axis=1, keepdims=True), n, direction(rng, len(n)))  # a face without area has none
    slope = (decades(rng, *aim.slopes, len(p)) * rng.choice([-1.0, 1.0], len(p)))[:, None]
    away = slope * n + np.sqrt(1.0 - slope * slope) * across(rng, n)
    o = make.rounded(p + size * decades(rng, *aim.distances, len(p))[:, None] * away)
    d = (p - o) / size
    length = np.linalg.norm(d, axis=1, keepdims=True)
    return o, make.rounded(np.divide(d, length, out=-away, where=length > 0.0))

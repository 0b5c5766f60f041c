"""Shapes of every kind, and rays aimed at them: of any size, distance and slope, at edges, rims and silhouettes.

Everything is rounded to float32 first, so that all who look at it see the same numbers.
"""

from typing import Any, NamedTuple

import numpy as np

from caster.description.fields import Shape
from caster.geometry.packing import pack
from caster.geometry.world_space import as_float32
from caster.scene.model import Scene
from caster.shapes import Cylinder, Disk, Icosphere, Plane, Sphere, Triangle

Rng = np.random.Generator


class Setting(NamedTuple):
    """How hard a scene is to get right."""

    size: float = 1.0
    offset: float = 0.0  # of the scene's middle from the origin
    distances: tuple[float, float] = (3.0, 100.0)  # between rays' origins and what they aim at, in sizes
    slopes: tuple[float, float] = (1e-3, 1.0)  # |cos| between ray and normal
    thin: float = 1.0  # the least extent over the greatest, where a shape can be stretched
    shear: float = 1.0  # a second stretch, along another axis, where a shape may be sheared
    edges: float = 0.3  # share of rays that aim at an edge, a corner or a rim


def direction(rng: Rng, count: int) -> np.ndarray:
    """(count, 3) unit vectors."""
    v = rng.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def decades(rng: Rng, low: float, high: float, count: int) -> np.ndarray:
    return 10.0 ** rng.uniform(np.log10(low), np.log10(high), count)


def placed(rng: Rng, setting: Setting, middle: np.ndarray, stretch: Any) -> list[dict[str, Any]]:
    """Steps that stretch, turn, shear and move."""
    turn = {"axis": direction(rng, 1)[0], "degrees": rng.uniform(0.0, 360.0)}
    move = middle + setting.size * rng.normal(size=3)
    across = [] if np.ndim(stretch) == 0 else [{"scale": [1.0, setting.shear, 1.0]}]
    return [{"scale": setting.size * np.array(stretch)}, {"rotate": turn}, *across, {"translate": move}]


def a_triangle(rng: Rng, setting: Setting, middle: np.ndarray) -> Shape:
    corners = rng.uniform(-1.0, 1.0, (3, 3)) * [1.0, 1.0, setting.thin]
    smooth = rng.random() < 0.5
    normals = direction(rng, 3) + np.array([0.0, 0.0, 2.0]) if smooth else None
    if normals is not None:
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    place = placed(rng, setting, middle, [1.0, 1.0, 1.0])
    return Triangle(vertices=corners, normals=normals, to_world=place)


def a_mesh(rng: Rng, setting: Setting, middle: np.ndarray) -> Shape:
    place = placed(rng, setting, middle, [1.0, 1.0, setting.thin])
    return Icosphere(subdivisions=2, face_normals=bool(rng.random() < 0.5), to_world=place)


def a_sphere(rng: Rng, setting: Setting, middle: np.ndarray) -> Shape:
    return Sphere(to_world=placed(rng, setting, middle, float(rng.uniform(0.3, 1.0))))


def an_ellipsoid(rng: Rng, setting: Setting, middle: np.ndarray) -> Shape:
    return Sphere(to_world=placed(rng, setting, middle, [1.0, 0.5, 0.5 * setting.thin]))


def a_disk(rng: Rng, setting: Setting, middle: np.ndarray) -> Shape:
    return Disk(to_world=placed(rng, setting, middle, [1.0, setting.thin, rng.uniform(0.5, 2.0)]))


def a_tube(rng: Rng, setting: Setting, middle: np.ndarray) -> Shape:
    radius = setting.thin * rng.uniform(0.3, 0.7)
    return Cylinder(radius=radius, to_world=placed(rng, setting, middle, 1.0))


def a_stretched_tube(rng: Rng, setting: Setting, middle: np.ndarray) -> Shape:
    return Cylinder(to_world=placed(rng, setting, middle, [0.5, 0.5 * setting.thin, 1.0]))


def a_plane(rng: Rng, setting: Setting, middle: np.ndarray) -> Shape:
    point = middle + setting.size * rng.normal(size=3)
    return Plane(normal=direction(rng, 1)[0], point=point)


KINDS = {
    "triangles": a_triangle,
    "meshes": a_mesh,
    "spheres": a_sphere,
    "ellipsoids": an_ellipsoid,
    "disks": a_disk,
    "cylinders": a_tube,
    "stretched cylinders": a_stretched_tube,
    "planes": a_plane,
}


def scene_of(kind: str, rng: Rng, setting: Setting, count: int) -> Scene:
    """`count` shapes of a kind around one middle."""
    middle = setting.offset * direction(rng, 1)[0]
    camera = {"type": "pinhole", "eye": middle, "look_at": middle + 1.0 + setting.offset}
    shapes = [KINDS[kind](rng, setting, middle) for _ in range(count)]
    return Scene(film={"width": 1, "height": 1}, camera=camera, shapes=shapes)


class Spots(NamedTuple):
    """Points of surfaces."""

    p: np.ndarray  # (n, 3)
    n: np.ndarray  # (n, 3) unit


def spots(part: Any, rng: Rng, count: int, edges: float) -> Spots:
    """Points of one shape's float32 arrays, a share of them on its edges."""
    on_edge = rng.random(count) < edges
    if hasattr(part, "faces"):
        return spots_of_triangles(part, rng, on_edge)
    if hasattr(part, "start"):  # segments of curves: near their surface
        k, along = rng.integers(0, len(part.start), count), rng.random(count)[:, None]
        axis, q = part.end[k] - part.start[k], direction(rng, count)
        q -= (q * axis).sum(axis=1, keepdims=True) / np.maximum((axis * axis).sum(axis=1, keepdims=True), 1e-300) * axis
        q /= np.linalg.norm(q, axis=1, keepdims=True)
        radius = part.radius[k, :1] + along * (part.radius[k, 1:] - part.radius[k, :1])
        return Spots(part.start[k] + along * axis + radius * q, q)
    if hasattr(part, "radius"):
        q = direction(rng, count)
        return Spots(part.center[0] + part.radius[0] * q, q)
    if hasattr(part, "normal"):
        across = np.cross(part.normal[0], rng.normal(size=(count, 3))) * decades(rng, 1e-2, 1e3, count)[:, None]
        return Spots(part.point[0] + across, np.tile(part.normal[0], (count, 1)))
    q, n = spots_of_unit(type(part).__name__, rng, on_edge)
    n = n @ part.to_object[0]
    return Spots(part.center[0] + q @ part.to_world[0].T, n / np.linalg.norm(n, axis=1, keepdims=True))


def spots_of_triangles(part: Any, rng: Rng, on_edge: np.ndarray) -> Spots:
    count = len(on_edge)
    corners = part.vertices[part.faces[rng.integers(0, len(part.faces), count)]]
    weights = rng.dirichlet(np.ones(3), count)
    weights[on_edge, rng.integers(0, 3)] = 0.0
    weights[on_edge & (rng.random(count) < 0.3)] = [1.0, 0.0, 0.0]
    weights /= weights.sum(axis=1, keepdims=True)
    n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return Spots(np.einsum("ij,ijk->ik", weights, corners), n / np.linalg.norm(n, axis=1, keepdims=True))


def spots_of_unit(kind: str, rng: Rng, on_edge: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(points, normals) of the unit ball, disk or tube."""
    count = len(on_edge)
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    round_, zero = np.column_stack([np.cos(angle), np.sin(angle)]), np.zeros(count)
    if kind in ("Ellipsoids", "OuterEllipsoids"):
        q = direction(rng, count)
        return q, q
    if kind == "Disks":
        radius = np.where(on_edge, 1.0, np.sqrt(rng.random(count)))
        return np.column_stack([radius[:, None] * round_, zero]), np.tile([0.0, 0.0, 1.0], (count, 1))
    height = np.where(on_edge, rng.integers(0, 2, count), rng.random(count))
    return np.column_stack([round_, height]), np.column_stack([round_, zero])


def rays_at(scene: Scene, rng: Rng, setting: Setting, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(o, d) float32 values as float64, (n, 3) each, d about of unit length; aimed at every shape in turn."""
    parts = pack(scene, as_float32).parts
    each = -(-count // len(parts))
    aims = [spots(part, rng, each, setting.edges) for part in parts]
    p, n = (np.concatenate(rows)[:count] for rows in zip(*aims, strict=True))
    slope = decades(rng, *setting.slopes, len(p)) * rng.choice([-1.0, 1.0], len(p))
    across = np.cross(n, direction(rng, len(p)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    d = slope[:, None] * n + np.sqrt(1.0 - slope**2)[:, None] * across
    o = p - (setting.size * decades(rng, *setting.distances, len(p)))[:, None] * d
    o = as_float32(o)
    d = p - o
    return o, as_float32(d / np.linalg.norm(d, axis=1, keepdims=True))

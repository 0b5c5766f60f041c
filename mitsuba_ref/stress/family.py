"""Families of settings in which one quantity gets extreme, and the random rays that they are made of."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from caster.cameras import Fisheye, Pinhole
from caster.description.fields import Shape
from caster.geometry.packing import pack
from caster.geometry.world_space import as_float32
from caster.scene.model import Film, Scene
from caster.shapes import Icosphere, Sphere

Rng = np.random.Generator

# Rays of a setting by default; in a closed mesh, exact arithmetic need not decide all of them.
DEFAULT_RAYS, DEFAULT_CLOSED_RAYS = 400, 10_000


class CameraRays(NamedTuple):
    """Rays of a setting that share an eye and a film: our caster also rasterizes them."""

    camera: Pinhole
    film: Film
    rays: np.ndarray  # (m,) indices of the setting's rays
    pixels: np.ndarray  # (m,) the pixel of the film's window that each goes through; all different


@dataclass(frozen=True, eq=False)
class Setting:
    """One point of a sweep: a scene and float32 rays through it, the same for all witnesses."""

    x: float  # the stressed quantity
    scene: Scene
    o: np.ndarray  # (n, 3) float32
    d: np.ndarray  # (n, 3) float32
    unit: float | None = None  # of errors, in scene units; None: relative to the distance
    camera_rays: Sequence[CameraRays] = ()
    closed: bool = False  # every ray starts inside a closed mesh, so that each of them hits


@dataclass(frozen=True)
class Family:
    """One sweep: settings over a stressed quantity."""

    name: str
    title: str  # what is stressed, in a line
    quantity: str  # the x axis, with its unit
    values: tuple[float, ...]  # of x, in ascending order
    easiest: float  # the x from which on settings get harder, to one side or to both
    make: Callable[[Rng, float, int], Setting] = field(repr=False)
    error: str = "relative error of t"
    misses: bool = True  # whether a setting without exact misses fails
    rays: int = DEFAULT_RAYS

    def settings(self, seed: int, rays: int | None) -> Iterator[Setting]:
        """The settings; each has a seed of its own, so that it does not depend on which others are swept."""
        for value in self.values:
            rng = np.random.default_rng([seed, *self.name.encode(), *np.float64(value).tobytes()])
            yield self.make(rng, value, rays or self.rays)


Rays = tuple[np.ndarray, np.ndarray]

CANDIDATES_PER_RAY = 64  # at the extreme end of a sweep few rays go where they were aimed
EYE_DISTANCE = 5.0  # sizes of the shape, from the shape to the rays' origins, unless stressed
MIN_ABS_COS = 0.3  # least |cos| between rays and the normal of a triangle that is not to be grazed
AIM_RADIUS = 1.4  # radii around the centre that rays are aimed at: about half of them hit
TARGET_MISS_SHARE = 0.4  # share of misses among the rays, where there are as many


def scene_of(*shapes: Shape) -> Scene:
    """A scene for any rays: its camera is one without a Mitsuba sensor, so that none is exported."""
    camera = Fisheye(eye=(0.0, 0.0, 0.0), direction=(0.0, 0.0, 1.0))
    return Scene(film={"width": 1, "height": 1}, camera=camera, shapes=shapes)


def part_of(scene: Scene, shape: int = 0) -> Any:
    """The packed arrays of one shape, of float32 values."""
    return pack(scene, as_float32).parts[shape]


def random_directions(rng: Rng, count: int) -> np.ndarray:
    """(count, 3) unit vectors."""
    v = rng.normal(size=(count, 3))
    return unit(v)


def unit(v: np.ndarray) -> np.ndarray:
    """Each row divided by its length."""
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def random_perpendicular(rng: Rng, n: np.ndarray) -> np.ndarray:
    """(m, 3) random unit vectors perpendicular to the rows of n."""
    return unit(np.cross(n, random_directions(rng, len(n))))


def random_turn(rng: Rng) -> dict[str, Any]:
    """A random rotation step of to_world, so that no coordinate is a round number."""
    return {"rotate": {"axis": random_directions(rng, 1)[0], "degrees": rng.uniform(20.0, 340.0)}}


def float32(a: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(a, np.float32)


def towards(o: np.ndarray, p: np.ndarray) -> Rays:
    """float32 rays from o to p, d of about unit length, aimed from the rounded o."""
    start = float32(o)
    return start, float32(unit(p - start.astype(np.float64)))


def balanced_selection(rays: Rays, inside: np.ndarray, count: int) -> Rays:
    """`count` of the candidates: misses up to their share, else hits. inside: (m,) whether a ray hits in float64.

    Float64 only chooses rays here; hits and misses are decided by exact arithmetic later.
    """
    hits, misses = np.flatnonzero(inside), np.flatnonzero(~inside)
    few = min(len(misses), max(count - len(hits), round(TARGET_MISS_SHARE * count)))
    rows = np.sort(np.concatenate([hits[: count - few], misses[:few]]))
    o, d = rays
    return o[rows], d[rows]


def select_rays(
    make: Callable[[int], Rays], seems_hit: Callable[[np.ndarray, np.ndarray], np.ndarray], count: int
) -> Rays:
    """`count` rays by `make`, a balanced selection of hits and misses."""
    o, d = make(CANDIDATES_PER_RAY * count)
    return balanced_selection((o, d), seems_hit(o.astype(np.float64), d.astype(np.float64)), count)


def hits_sphere(center: np.ndarray, r: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Whether lines pass a centre within r."""
    return lambda o, d: impact_parameter(center, o, d) < r


def impact_parameter(center: np.ndarray, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """(n,) distance at which each ray's line passes a point."""
    v = unit(d)
    return np.linalg.norm(np.cross(center - o, v), axis=1)


def rays_to_triangle(rng: Rng, corners: np.ndarray, n: np.ndarray, distance: float, count: int) -> Rays:
    """Rays from this distance to points of a triangle (3, 3) with unit normal n, and to points just beside it."""
    v = random_directions(rng, count)
    v[np.abs(v @ n) < MIN_ABS_COS] = n
    aim = (rng.dirichlet(np.ones(3), count) * 1.4 - 0.4 / 3.0) @ corners
    return towards(aim + distance * v, aim)


def unit_normal(corners: np.ndarray) -> np.ndarray:
    n = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    return n / np.linalg.norm(n)


def hits_triangles(corners: np.ndarray) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Whether lines cross any of a few triangles (k, 3, 3)."""

    def test(o: np.ndarray, d: np.ndarray) -> np.ndarray:
        found = np.zeros(len(o), bool)
        for triangle in corners:
            a, b, c = (corner - o for corner in triangle)
            sides = [np.einsum("ij,ij->i", d, np.cross(p, q)) for p, q in ((c, b), (a, c), (b, a))]
            found |= (np.min(sides, axis=0) >= 0.0) | (np.max(sides, axis=0) <= 0.0)
        return found

    return test


def sphere_scene(radius: float, center: np.ndarray) -> Scene:
    return scene_of(Sphere(center=center, radius=radius))


def icosphere_scene(rng: Rng, radius: float, center: np.ndarray) -> Scene:
    """80 triangles, rotated."""
    place = [{"scale": radius}, random_turn(rng), {"translate": center}]
    return scene_of(Icosphere(subdivisions=1, face_normals=True, to_world=place))


def setting_around(rng: Rng, x: float, scene: Scene, view: tuple[np.ndarray, float, float], count: int) -> Setting:
    """Rays from all directions to a sphere, view = (its centre, its radius, distance of the origins)."""
    center, radius, distance = view
    part = part_of(scene)

    def make(many: int) -> tuple[np.ndarray, np.ndarray]:
        around = random_directions(rng, many)
        aim = center + AIM_RADIUS * radius * np.sqrt(rng.random((many, 1))) * random_directions(rng, many)
        return towards(center + distance * around, aim)

    if hasattr(part, "radius"):
        hits = hits_sphere(part.center[0], part.radius[0])
    else:
        hits = hits_triangles(part.vertices[part.faces])
    return Setting(x, scene, *select_rays(make, hits, count))

"""What is stressed, and how: a family of settings that get harder and harder."""

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

# How many rays a setting has unless told; in a closed mesh, exact arithmetic need not look at all of them.
DEFAULT_RAYS, DEFAULT_CLOSED_RAYS = 400, 10_000


class CameraRays(NamedTuple):
    """Rays of a setting that share an eye and a film: ours casts them through the screen, too."""

    camera: Pinhole
    film: Film
    rays: np.ndarray  # (m,) which of the setting's rays
    pixels: (
        np.ndarray
    )  # (m,) the pixel of the film's window that each goes through, row by row; all different


@dataclass(frozen=True, eq=False)
class Setting:
    """One point of a sweep: a scene, and rays of float32 numbers through it, for everybody."""

    x: float  # the stressed quantity
    scene: Scene
    o: np.ndarray  # (n, 3) float32
    d: np.ndarray  # (n, 3) float32
    unit: float | None = None  # what errors are measured in, scene units; None: relative to the distance
    shots: Sequence[CameraRays] = ()
    closed: bool = False  # every ray starts inside a closed mesh, so that each of them hits


@dataclass(frozen=True)
class Family:
    """One sweep. `settings(rng of each x, rays)` begins with the easiest, or with the smallest x."""

    name: str
    title: str  # what is stressed, in a line
    quantity: str  # the x axis, with its unit
    values: tuple[float, ...]  # of x, in ascending order
    easiest: float  # the value of x from where on it gets harder, to one side or to both
    make: Callable[[Rng, float, int], Setting] = field(repr=False)
    error: str = "relative error of t"
    misses: bool = True  # whether exact misses have to be among the answers, beside hits
    rays: int = DEFAULT_RAYS

    def settings(self, seed: int, rays: int | None) -> Iterator[Setting]:
        """Every setting by a seed of its own: none depends on which others are asked for."""
        for value in self.values:
            rng = np.random.default_rng([seed, *self.name.encode(), *np.float64(value).tobytes()])
            yield self.make(rng, value, rays or self.rays)


# Rays that are aimed: float32 numbers, and enough hits and misses among them to tell anything.


Rays = tuple[np.ndarray, np.ndarray]

CANDIDATES_PER_RAY = (
    64  # rays made for each one that is kept: at the far end of a sweep few go where they were aimed
)
TARGET_MISS_SHARE = 0.4  # share of rays that are to miss, where there are so many


def scene_of(*shapes: Shape) -> Scene:
    """A scene to hand rays to: its camera is one that Mitsuba has no sensor for, so that none is exported."""
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
    """(m, 3) unit vectors at right angles to the rows of n, turned at random."""
    return unit(np.cross(n, random_directions(rng, len(n))))


def random_turn(rng: Rng) -> dict[str, Any]:
    """A step of to_world: any rotation, so that no coordinate is a round number."""
    return {"rotate": {"axis": random_directions(rng, 1)[0], "degrees": rng.uniform(20.0, 340.0)}}


def float32(a: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(a, np.float32)


def towards(o: np.ndarray, p: np.ndarray) -> Rays:
    """float32 rays from about o to p, d about of length 1: aimed from where o was rounded to."""
    start = float32(o)
    return start, float32(unit(p - start.astype(np.float64)))


def balanced_selection(rays: Rays, inside: np.ndarray, count: int) -> Rays:
    """`count` of the candidates: misses up to their share, hits else. inside: (m,) whether a ray seems to hit.

    What seems so in float64 only chooses rays; who hits is for exact arithmetic to say.
    """
    hits, misses = np.flatnonzero(inside), np.flatnonzero(~inside)
    few = min(len(misses), max(count - len(hits), round(TARGET_MISS_SHARE * count)))
    rows = np.sort(np.concatenate([hits[: count - few], misses[:few]]))
    o, d = rays
    return o[rows], d[rows]


def select_rays(
    make: Callable[[int], Rays], seems_hit: Callable[[np.ndarray, np.ndarray], np.ndarray], count: int
) -> Rays:
    """Candidates by `make`, and of them `count` that hit and miss in good measure."""
    o, d = make(CANDIDATES_PER_RAY * count)
    return balanced_selection((o, d), seems_hit(o.astype(np.float64), d.astype(np.float64)), count)


def hits_sphere(center: np.ndarray, r: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Whether rays pass a centre within r, ahead of their origin or not."""
    return lambda o, d: impact_parameter(center, o, d) < r


def impact_parameter(center: np.ndarray, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """(n,) distance at which each ray's line passes a point."""
    v = unit(d)
    return np.linalg.norm(np.cross(center - o, v), axis=1)


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


# What the sweeps of scale, offset and distance share: one ball, of triangles or of one equation, seen from afar.


AIM_RADIUS = 1.4  # radius around the middle that rays are aimed at, in radii: about half of them hit


def sphere_scene(radius: float, center: np.ndarray) -> Scene:
    return scene_of(Sphere(center=center, radius=radius))


def icosphere_scene(rng: Rng, radius: float, center: np.ndarray) -> Scene:
    """80 triangles, turned."""
    place = [{"scale": radius}, random_turn(rng), {"translate": center}]
    return scene_of(Icosphere(subdivisions=1, face_normals=True, to_world=place))


def setting_around(
    rng: Rng, x: float, scene: Scene, view: tuple[np.ndarray, float, float], count: int
) -> Setting:
    """Rays from all around to a ball, view = (its center, its radius, their distance)."""
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

"""Scenes of the benchmark, in float32 numbers, so that all casters cast the same ones."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from caster.aovs import BY_NAME
from caster.cameras import Fisheye, Orthographic, Pinhole
from caster.description.errors import SceneError, suggestion
from caster.scene.files import load_scene
from caster.scene.model import Ambient, Diffuse, Point, Scene
from caster.shapes import Cylinder, Disk, Heightfield, Plane, Rectangle, Sphere, SphereCloud, Teapot, Torus
from mitsuba_ref.bench.drivers import ANY, AOVS, FILM, NEAREST
from mitsuba_ref.hard.swept_families import unit

Rays = tuple[np.ndarray, np.ndarray]  # o, d: (n, 3) float32 each


@dataclass(frozen=True)
class BenchScene:
    """One scene of the benchmark.

    workload: FILM, an image of `aovs`; NEAREST, t and normals along given rays; ANY, whether given rays hit anything.
    """

    name: str
    title: str
    make: Callable[[], Scene]
    workload: str = FILM
    rays: Callable[[Scene], Rays] | None = None  # None: the camera's
    aovs: tuple[str, ...] = AOVS


VIEW: dict[str, Any] = {"eye": (0.0, -4.0, 1.5), "look_at": (0.0, 0.0, 0.0), "up": (0.0, 0.0, 1.0)}
LIT: dict[str, Any] = {
    "lights": [Point(position=(2.0, -3.0, 3.0), intensity=(40.0, 40.0, 40.0)), Ambient(radiance=(0.05, 0.05, 0.05))],
    "materials": {"grey": Diffuse(reflectance=(0.5, 0.5, 0.5))},
}


def from_front(*shapes: Any, camera: Any = None, **more: Any) -> Scene:
    """A scene seen from the front, somewhat above; its film gets a size later."""
    return Scene(camera=camera or Pinhole(**VIEW, fov=40.0), shapes=shapes, **more)


def spheres(count: int) -> Scene:
    """Random spheres in a cube; together they cover most of the view."""
    rng = np.random.default_rng(count)
    centers = rng.uniform(-1.0, 1.0, (count, 3))
    radii = rng.uniform(0.3, 1.0, count) * 0.8 * count ** (-1.0 / 3.0)
    return from_front(SphereCloud(centers=centers, radii=radii))


def ring(camera: Any = None) -> Scene:
    """A closed torus of 70,224 triangles: silhouettes, and surface behind surface."""
    return from_front(Torus(minor_radius=0.4, segments=264, sides=133, face_normals=True), camera=camera)


def hills() -> Scene:
    """A hilly square of side 2, of 2 * 707^2 triangles."""
    return from_front(Heightfield(size=2.0, resolution=707, amplitude=0.2, waves=8, seed=0, face_normals=True))


def layers() -> Scene:
    """Squares behind each other, in random order: every ray crosses all of them."""
    # Off the middle, or a pixel in a thousand would lie exactly on the diagonal of every square.
    camera = Pinhole(eye=(0.117, 0.053, 3.0), look_at=(0.031, 0.017, 0.0), up=(0.0, 1.0, 0.0), fov=20.0)
    order = np.random.default_rng(0).permutation(256)
    squares = [Rectangle(to_world=[{"translate": (0.0, 0.0, -place / 64.0)}]) for place in order]
    return Scene(camera=camera, shapes=squares)


def grazing() -> Scene:
    camera = Pinhole(eye=(0.0, -20.0, 0.01), direction=(0.0, 1.0, 0.0), up=(0.0, 0.0, 1.0), fov=40.0)
    return Scene(camera=camera, shapes=[Rectangle(to_world=[{"scale": 1000.0}])])


def several_kinds() -> Scene:
    """A teapot, forty spheres, cylinders and disks on a plane, lit."""
    rng = np.random.default_rng(4)
    around = [(1.7 * np.cos(a), 1.7 * np.sin(a), z) for a, z in zip(*rng.uniform(0, 6, (2, 40)), strict=True)]
    smaller = [{"scale": 0.45}, {"translate": (0.0, 0.0, -0.6)}]
    shapes: list[Any] = [Teapot(subdivisions=10, to_world=smaller, material="grey")]
    shapes += [Plane(point=(0.0, 0.0, -0.6), normal=(0.0, 0.0, 1.0), material="grey")]
    shapes += [Sphere(center=(x, y, 0.15 * z - 0.5), radius=0.08, material="grey") for x, y, z in around]
    for x, y, z in around[:8]:
        ends = {"p0": (0.6 * x, 0.6 * y, -0.6), "p1": (0.6 * x, 0.6 * y, 0.1 * z)}
        shapes.append(Cylinder(**ends, radius=0.05, material="grey"))
        place = [{"scale": 0.12}, {"translate": (0.8 * x, 0.8 * y, 0.1 * z)}]
        shapes.append(Disk(to_world=place, material="grey"))
    return from_front(*shapes, **LIT)


def incoherent(scene: Scene) -> Rays:
    """Incoherent rays, from random points of a sphere around the scene to random points within."""
    rng, count = np.random.default_rng(1), scene.film.width * scene.film.height
    start = (3.0 * unit(rng.normal(size=(count, 3)))).astype(np.float32)
    p = rng.uniform(-1.0, 1.0, (count, 3)) * [1.4, 1.4, 0.4]
    return start, unit(p - start).astype(np.float32)


def shadow_rays_to_light(scene: Scene) -> Rays:
    """Shadow rays from points near the surface to one light, which is at t = 1."""
    rng, count = np.random.default_rng(2), scene.film.width * scene.film.height
    u, v = 2.0 * np.pi * rng.random((2, count))
    tube = 1.0 + 0.41 * np.cos(v)
    o = np.column_stack([tube * np.cos(u), tube * np.sin(u), 0.41 * np.sin(v)]).astype(np.float32)
    return o, (np.array([2.0, -3.0, 3.0]) - o).astype(np.float32)


def scene_of_file(path: str, mesh_dirs: Sequence[str] = ()) -> BenchScene:
    """The scene of a scene or mesh file. Raises SceneError, FileMissing."""
    scene = load_scene(path, mesh_dirs)
    return BenchScene(Path(path).stem, path, lambda: scene)


def with_aovs(scene: BenchScene, aovs: Sequence[str]) -> BenchScene:
    """The same scene with other AOVs. Raises SceneError for an unknown name."""
    for name in aovs:
        if name not in BY_NAME:
            hint = suggestion(name, BY_NAME)
            raise SceneError(f"--aov {name}: unknown{hint} (known: {', '.join(BY_NAME)})")
    names = tuple(aovs)
    return scene if names == AOVS else replace(scene, name=f"{scene.name}:{','.join(names)}", aovs=names)


MESH = "the mesh of 70,224 triangles"
SCENES = (
    BenchScene("one-sphere", "one sphere", lambda: from_front(Sphere(center=(0.0, 0.0, 0.0), radius=1.0))),
    BenchScene("spheres-200", "200 spheres", lambda: spheres(200)),
    BenchScene("spheres-10k", "10,000 spheres", lambda: spheres(10_000)),
    BenchScene("mesh-70k", "a closed mesh of 70,224 triangles", ring),
    BenchScene("mesh-1m", "hills of 999,698 triangles", hills),
    BenchScene("overdraw-256", "256 squares behind each other", layers),
    BenchScene("grazing-plane", "a square of two triangles, seen at half a thousandth of a radian", grazing),
    BenchScene("orthographic", f"{MESH}, parallel rays", lambda: ring(Orthographic(**VIEW, width=3.0))),
    BenchScene(
        "fisheye",
        f"{MESH}, a fisheye of 180 degrees",
        lambda: ring(Fisheye(**VIEW | {"eye": (0.0, -1.0, 0.2)}, fov=180.0)),
    ),
    BenchScene("rays-coherent", f"the camera's rays at {MESH}, handed over", ring, NEAREST),
    BenchScene("rays-incoherent", f"rays in any order at {MESH}", ring, NEAREST, incoherent),
    BenchScene("rays-shadow", "whether anything lies between the mesh and a light", ring, ANY, shadow_rays_to_light),
    BenchScene("kinds", "a teapot, spheres, cylinders and disks on a plane", several_kinds),
    BenchScene("kinds-lit", "the same, lit by a point light with shadows", several_kinds, aovs=(*AOVS, "diffuse")),
)

"""Scenes of the benchmark, in float32 numbers, so that all casters cast the same ones."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from caster.cameras import Pinhole
from caster.rendering.images import check_names
from caster.scene.files import load_scene
from caster.scene.model import Scene
from caster.shapes import Rectangle, SphereCloud
from mitsuba_ref.bench.drivers import AOVS, FILM, NEAREST
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.hard.swept_families import unit

Rays = tuple[Array, Array]  # o, d: (n, 3) float32 each


@dataclass(frozen=True)
class BenchScene:
    """One scene of the benchmark.

    workload: FILM, an image of `aovs`; NEAREST, t and normals along given rays.
    """

    name: str
    title: str
    make: Callable[[], Scene]
    workload: str = FILM
    rays: Callable[[Scene], Rays] | None = None  # None: the camera's
    aovs: tuple[str, ...] = AOVS


STANDARD = Path(__file__).with_name("standard")  # scene files; films get a size later


def standard(name: str) -> Scene:
    return load_scene(STANDARD / f"{name}.toml")


def spheres(count: int) -> Scene:
    """Random spheres in a cube; together they cover most of the view."""
    rng = np.random.default_rng(count)
    centers = rng.uniform(-1.0, 1.0, (count, 3))
    radii = rng.uniform(0.3, 1.0, count) * 0.8 * count ** (-1.0 / 3.0)
    return Scene(camera=standard("one-sphere").camera, shapes=[SphereCloud(centers=centers, radii=radii)])


def layers() -> Scene:
    """Squares behind each other, in random order: every ray crosses all of them."""
    # Off the middle, or a pixel in a thousand would lie exactly on the diagonal of every square.
    camera = Pinhole(eye=(0.117, 0.053, 3.0), look_at=(0.031, 0.017, 0.0), up=(0.0, 1.0, 0.0), fov=20.0)
    order = np.random.default_rng(0).permutation(256)
    squares = [Rectangle(to_world=[{"translate": (0.0, 0.0, -place / 64.0)}]) for place in order]
    return Scene(camera=camera, shapes=squares)


def incoherent(scene: Scene) -> Rays:
    """Incoherent rays, from random points of a sphere around the scene to random points within."""
    rng, count = np.random.default_rng(1), scene.film.width * scene.film.height
    start = (3.0 * unit(rng.normal(size=(count, 3)))).astype(np.float32)
    p = rng.uniform(-1.0, 1.0, (count, 3)) * [1.4, 1.4, 0.4]
    return start, unit(p - start).astype(np.float32)


def scene_of_file(path: str, mesh_dirs: Sequence[str] = ()) -> BenchScene:
    """The scene of a scene or mesh file. Raises SceneError, FileMissing."""
    load_scene(path, mesh_dirs)  # its errors come before any work
    return BenchScene(Path(path).stem, path, partial(load_scene, path, mesh_dirs))


def with_aovs(scene: BenchScene, aovs: Sequence[str]) -> BenchScene:
    """The same scene with other AOVs. Raises SceneError for an unknown name."""
    check_names(aovs)
    names = tuple(aovs)
    return scene if names == AOVS else replace(scene, name=f"{scene.name}:{','.join(names)}", aovs=names)


def of_file(name: str, title: str, *rest: Any, file: str = "", **more: Any) -> BenchScene:
    """file: the name of a standard scene, that of this one unless given."""
    return BenchScene(name, title, partial(standard, file or name), *rest, **more)


RING, MESH = "mesh-70k", "the mesh of 70,224 triangles"
SCENES = (
    of_file("one-sphere", "one sphere"),
    BenchScene("spheres-200", "200 spheres", partial(spheres, 200)),
    BenchScene("spheres-10k", "10,000 spheres", partial(spheres, 10_000)),
    of_file(RING, "a closed mesh of 70,224 triangles"),
    of_file("mesh-1m", "hills of 999,698 triangles"),
    BenchScene("overdraw-256", "256 squares behind each other", layers),
    of_file("grazing-plane", "a square of two triangles, seen at half a thousandth of a radian"),
    of_file("orthographic", f"{MESH}, parallel rays"),
    of_file("fisheye", f"{MESH}, a fisheye of 180 degrees"),
    of_file("rays-coherent", f"the camera's rays at {MESH}, handed over", NEAREST, file=RING),
    of_file("rays-incoherent", f"rays in any order at {MESH}", NEAREST, incoherent, file=RING),
    of_file("kinds", "a teapot, spheres, cylinders and disks on a plane"),
    of_file("kinds-lit", "the same, lit by a point light with shadows", aovs=(*AOVS, "diffuse"), file="kinds"),
)

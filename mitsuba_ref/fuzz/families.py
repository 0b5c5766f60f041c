"""The registry of families: which kind of trouble a random scene and its rays look for."""

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from caster.geometry.packing import Packed
from caster.scene.model import Scene
from mitsuba_ref.fuzz import aims, kinds
from mitsuba_ref.fuzz.aims import Aim, Shots, Targets, aimed_rays
from mitsuba_ref.fuzz.groups import coincident_shapes, slivers, triangle_fan
from mitsuba_ref.fuzz.kinds import CAMERA_TYPES as CAMERAS
from mitsuba_ref.fuzz.kinds import (
    FILM_SIZES,
    bounded_types,
    random_shape,
    shape_types,
)
from mitsuba_ref.fuzz.settings import Setting, log_uniform, random_lattice_setting, random_setting
from mitsuba_ref.shapes.targets import Rng

Shapes = list[dict[str, Any]]
DrawScene = Callable[[Rng], tuple[Setting, Shapes]]


class Family(NamedTuple):
    """Scenes of one kind of trouble, and how rays are aimed at them."""

    name: str
    about: str
    draw: DrawScene
    aims: tuple[Aim, ...] = aims.ALL_AIMS
    fits_float32: bool = True  # so that Mitsuba may be asked about it
    cameras: tuple[str, ...] = CAMERAS
    films: tuple[tuple[int, int], ...] = FILM_SIZES


def random_shapes(rng: Rng, setting: Setting, kinds: tuple[str, ...], most: int) -> Shapes:
    return [random_shape(rng, str(rng.choice(kinds)), setting) for _ in range(int(rng.integers(1, most + 1)))]


def any_shapes(rng: Rng) -> tuple[Setting, Shapes]:
    setting = random_setting(rng)
    return setting, random_shapes(rng, setting, shape_types(), 5)


def shared_edges(rng: Rng) -> tuple[Setting, Shapes]:
    setting = random_setting(rng)
    if rng.random() < 0.5:
        return setting, triangle_fan(rng, setting)
    return setting, random_shapes(rng, setting, shape_types("mesh"), 2)


def quadrics(rng: Rng) -> tuple[Setting, Shapes]:
    setting = random_setting(rng)
    return setting, random_shapes(rng, setting, shape_types("quadric"), 4)


def ties(rng: Rng) -> tuple[Setting, Shapes]:
    setting = random_setting(rng)
    return setting, coincident_shapes(rng, setting)


def flat_shapes(rng: Rng) -> tuple[Setting, Shapes]:
    setting = random_setting(rng)
    return setting, random_shapes(rng, setting, shape_types("flat"), 4)


def on_the_lattice(rng: Rng) -> tuple[Setting, Shapes]:
    setting = random_lattice_setting(rng)
    return setting, random_shapes(rng, setting, shape_types(), 4)


def sliver_scenes(rng: Rng) -> tuple[Setting, Shapes]:
    setting = random_setting(rng)
    return setting, slivers(rng, setting)


def tiny_and_huge(rng: Rng) -> tuple[Setting, Shapes]:
    """Sizes from 1e-100 to 1e17: squares of numbers that leave the range of float64, or nearly so."""
    size = log_uniform(rng, 1e-100, 1e-20) if rng.random() < 0.5 else log_uniform(rng, 1e10, 1e17)
    setting = Setting(size, (0.0, 0.0, 0.0), 10.0)
    return setting, random_shapes(rng, setting, shape_types(), 3)


def transformed(rng: Rng) -> tuple[Setting, Shapes]:
    setting = Setting(1.0, (0.0, 0.0, 0.0), condition=1e6)
    return setting, random_shapes(rng, setting, bounded_types(), 4)


def far_off(rng: Rng) -> tuple[Setting, Shapes]:
    """Shapes 1e3 to 1e9 of their sizes away from the origin."""
    size = log_uniform(rng, 1e-3, 1e3)
    away = size * log_uniform(rng, 1e3, 1e9) * rng.normal(size=3)
    setting = Setting(size, (float(away[0]), float(away[1]), float(away[2])), 10.0)
    return setting, random_shapes(rng, setting, shape_types(), 4)


def clutter(rng: Rng) -> tuple[Setting, Shapes]:
    """Many small primitives through each other: deep trees, crowded pictures."""
    setting = random_lattice_setting(rng) if rng.random() < 0.3 else Setting(1.0, (0.0, 0.0, 0.0), 10.0)
    kinds = list(shape_types("small"))
    if rng.random() < 0.5:
        kinds = [str(rng.choice(kinds))]  # so that its tree is deep
    return setting, [
        random_shape(rng, str(rng.choice(kinds)), setting) for _ in range(int(rng.integers(10, 30)))
    ]


def small_images(rng: Rng) -> tuple[Setting, Shapes]:
    """Shapes a few pixels wide."""
    setting = Setting(0.25, (0.0, 0.0, 0.0), 10.0) if rng.random() < 0.6 else random_lattice_setting(rng)
    return setting, random_shapes(rng, setting, bounded_types(), 4)


FAMILIES: tuple[Family, ...] = (
    Family("any", "all shapes, all ways to aim", any_shapes),
    Family(
        "edges",
        "shared edges and corners of meshes",
        shared_edges,
        (aims.at_features, aims.along_axes, aims.between_two_points),
    ),
    Family(
        "tangents",
        "rays that touch spheres, ellipsoids, cylinders and rims",
        quadrics,
        (aims.tangents, aims.at_features),
    ),
    Family("ties", "surfaces that coincide, or nearly so", ties),
    Family(
        "surfaces",
        "rays that start on a surface",
        any_shapes,
        (aims.from_surface, aims.between_two_points, aims.tangents),
    ),
    Family(
        "planes",
        "rays in the planes of flat shapes",
        flat_shapes,
        (aims.through_two_points, aims.along_axes, aims.tangents),
    ),
    Family("lattice", "whole coordinates, axis directions, zeros of either sign", on_the_lattice),
    Family("slivers", "needles, caps, and faces without an area", sliver_scenes),
    Family("extremes", "sizes from 1e-100 to 1e17, denormal components", tiny_and_huge, fits_float32=False),
    Family("transforms", "stretched, sheared and mirrored shapes, condition up to 1e6", transformed),
    Family(
        "offsets",
        "far from the origin, seen from near and far",
        far_off,
        (aims.at_features, aims.from_afar, aims.anywhere),
    ),
    Family("clutter", "many primitives through each other", clutter),
    Family(
        "pictures",
        "small shapes on larger films, by cameras that look for each shape's pixels",
        small_images,
        cameras=("pinhole", "orthographic"),
        films=((16, 12), (13, 13)),
    ),
)
BY_NAME = {family.name: family for family in FAMILIES}


def seed_of_family(family: Family) -> int:
    return seed_of_name(family.name)


def seed_of_name(name: str) -> int:
    """A number that stays the same when others are added before it."""
    return zlib.crc32(name.encode())


# Example i of seed S: a scene and rays, the same whenever and wherever they are asked for.


RAYS_PER_EXAMPLE = 40  # of an example, before those with limits


@dataclass(frozen=True)
class Example:
    """One scene to try. `data` is the scene as a scene file has it."""

    seed: int
    number: int
    family: Family
    setting: Setting
    data: dict[str, Any]

    @property
    def options(self) -> str:
        """The options that make it again."""
        return f"--seed {self.seed} --family {self.family.name} --examples {self.number}..{self.number}"

    def random(self, purpose: int) -> Rng:
        """Random numbers of its own, the same each time; others for each purpose."""
        return np.random.default_rng([self.seed, self.number, seed_of_family(self.family), purpose])

    def shots(self, packed: Packed, rays: int = RAYS_PER_EXAMPLE) -> Shots:
        """The rays to cast."""
        return aimed_rays(self.random(AIM_STREAM), Targets(packed), self.setting, rays, self.family.aims)


SCENE_STREAM, AIM_STREAM, LIMIT_STREAM, MITSUBA_STREAM = range(4)  # purposes


def example(seed: int, number: int, families: Sequence[Family]) -> Example:
    """Families take turns, so a family that is asked for alone has other examples of the same numbers."""
    family = families[number % len(families)]
    rng = np.random.default_rng([seed, number, seed_of_family(family), SCENE_STREAM])
    setting, shapes = family.draw(rng)
    film, camera = kinds.random_camera(rng, setting, family.cameras, family.films)
    return Example(seed, number, family, setting, {"film": film, "camera": camera, "shape": shapes})


def scene_of(data: dict[str, Any]) -> Scene:
    """Raises SceneError, or pydantic's ValidationError, for what is no scene."""
    scene: Scene = Scene.model_validate(data)
    return scene

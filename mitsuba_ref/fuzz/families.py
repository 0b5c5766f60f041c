"""The registry of families: which kind of trouble a random scene and its rays look for."""

import zlib
from collections.abc import Callable
from typing import Any, NamedTuple

from mitsuba_ref.fuzz import aims
from mitsuba_ref.fuzz.aims import Aim
from mitsuba_ref.fuzz.cameras import FILMS
from mitsuba_ref.fuzz.cameras import TYPES as CAMERAS
from mitsuba_ref.fuzz.setting import Rng, Setting, any_setting, decades, lattice_setting
from mitsuba_ref.fuzz.shapes import FLAT, MESHES, QUADRICS, TYPES, drawn
from mitsuba_ref.fuzz.ties import tied
from mitsuba_ref.fuzz.triangles import around_one_corner, slivers

Shapes = list[dict[str, Any]]
Draw = Callable[[Rng], tuple[Setting, Shapes]]


class Family(NamedTuple):
    """Scenes of one kind of trouble, and how rays are aimed at them."""

    name: str
    about: str
    draw: Draw
    aims: tuple[Aim, ...] = aims.ALL
    fits_float32: bool = True  # so that Mitsuba may be asked about it
    cameras: tuple[str, ...] = CAMERAS
    films: tuple[tuple[int, int], ...] = FILMS


def several(rng: Rng, setting: Setting, kinds: tuple[str, ...], most: int) -> Shapes:
    return [drawn(rng, str(rng.choice(kinds)), setting) for _ in range(int(rng.integers(1, most + 1)))]


def any_shapes(rng: Rng) -> tuple[Setting, Shapes]:
    setting = any_setting(rng)
    return setting, several(rng, setting, TYPES, 5)


def shared_edges(rng: Rng) -> tuple[Setting, Shapes]:
    setting = any_setting(rng)
    if rng.random() < 0.5:
        return setting, around_one_corner(rng, setting)
    return setting, several(rng, setting, MESHES, 2)


def quadrics(rng: Rng) -> tuple[Setting, Shapes]:
    setting = any_setting(rng)
    return setting, several(rng, setting, QUADRICS, 4)


def ties(rng: Rng) -> tuple[Setting, Shapes]:
    setting = any_setting(rng)
    return setting, tied(rng, setting)


def flat_shapes(rng: Rng) -> tuple[Setting, Shapes]:
    setting = any_setting(rng)
    return setting, several(rng, setting, FLAT, 4)


def on_the_lattice(rng: Rng) -> tuple[Setting, Shapes]:
    setting = lattice_setting(rng)
    return setting, several(rng, setting, TYPES, 4)


def sliver_scenes(rng: Rng) -> tuple[Setting, Shapes]:
    setting = any_setting(rng)
    return setting, slivers(rng, setting)


def tiny_and_huge(rng: Rng) -> tuple[Setting, Shapes]:
    """Sizes from 1e-100 to 1e17: squares of numbers that leave the range of float64, or nearly so."""
    size = decades(rng, 1e-100, 1e-20) if rng.random() < 0.5 else decades(rng, 1e10, 1e17)
    setting = Setting(size, (0.0, 0.0, 0.0), 10.0)
    return setting, several(rng, setting, TYPES, 3)


def transformed(rng: Rng) -> tuple[Setting, Shapes]:
    setting = Setting(1.0, (0.0, 0.0, 0.0), condition=1e6)
    return setting, several(rng, setting, tuple(kind for kind in TYPES if kind != "plane"), 4)


def far_off(rng: Rng) -> tuple[Setting, Shapes]:
    """Shapes 1e3 to 1e9 of their sizes away from the origin."""
    size = decades(rng, 1e-3, 1e3)
    away = size * decades(rng, 1e3, 1e9) * rng.normal(size=3)
    setting = Setting(size, (float(away[0]), float(away[1]), float(away[2])), 10.0)
    return setting, several(rng, setting, TYPES, 4)


def clutter(rng: Rng) -> tuple[Setting, Shapes]:
    """Many small primitives through each other: deep trees, crowded pictures."""
    setting = lattice_setting(rng) if rng.random() < 0.3 else Setting(1.0, (0.0, 0.0, 0.0), 10.0)
    kinds = ["sphere", "cylinder", "disk", "triangle", "rectangle"]
    if rng.random() < 0.5:
        kinds = [str(rng.choice(kinds))]  # so that its tree is deep
    return setting, [drawn(rng, str(rng.choice(kinds)), setting) for _ in range(int(rng.integers(10, 30)))]


def small_pictures(rng: Rng) -> tuple[Setting, Shapes]:
    """Shapes a few pixels wide."""
    setting = Setting(0.25, (0.0, 0.0, 0.0), 10.0) if rng.random() < 0.6 else lattice_setting(rng)
    return setting, several(rng, setting, tuple(kind for kind in TYPES if kind != "plane"), 4)


FAMILIES: tuple[Family, ...] = (
    Family("any", "all shapes, all ways to aim", any_shapes),
    Family(
        "edges",
        "shared edges and corners of meshes",
        shared_edges,
        (aims.at_places, aims.along_axes, aims.between_two),
    ),
    Family(
        "tangents",
        "rays that touch spheres, ellipsoids, cylinders and rims",
        quadrics,
        (aims.tangents, aims.at_places),
    ),
    Family("ties", "surfaces that coincide, or nearly so", ties),
    Family(
        "surfaces",
        "rays that start on a surface",
        any_shapes,
        (aims.from_places, aims.between_two, aims.tangents),
    ),
    Family(
        "planes",
        "rays in the planes of flat shapes",
        flat_shapes,
        (aims.through_two, aims.along_axes, aims.tangents),
    ),
    Family("lattice", "whole coordinates, axis directions, zeros of either sign", on_the_lattice),
    Family("slivers", "needles, caps, and faces without an area", sliver_scenes),
    Family("extremes", "sizes from 1e-100 to 1e17, denormal components", tiny_and_huge, fits_float32=False),
    Family("transforms", "stretched, sheared and mirrored shapes, condition up to 1e6", transformed),
    Family(
        "offsets",
        "far from the origin, seen from near and far",
        far_off,
        (aims.at_places, aims.from_afar, aims.anywhere),
    ),
    Family("clutter", "many primitives through each other", clutter),
    Family(
        "pictures",
        "small shapes on larger films, by cameras that look for each shape's pixels",
        small_pictures,
        cameras=("pinhole", "orthographic"),
        films=((16, 12), (13, 13)),
    ),
)
BY_NAME = {family.name: family for family in FAMILIES}


def number_of(family: Family) -> int:
    return number_of_name(family.name)


def number_of_name(name: str) -> int:
    """A number that stays the same when others are added before it."""
    return zlib.crc32(name.encode())

"""Families of surfaces that rays leave, for the origins of these rays: one quantity gets extreme in each."""

from typing import Any

import numpy as np

from caster.geometry.packing import Packed
from mitsuba_ref.hard.family import Family, Fields, HardScene, plain
from mitsuba_ref.hard.rays import RayBatch, Targets
from mitsuba_ref.hard.swept_families import (
    ANGLE,
    EYE_DISTANCE,
    NO_VIEW,
    OFFSET,
    TENFOLD,
    TINY,
    UP_TO_ONE,
    batch,
    decades,
    directions,
    icosphere,
    near_origin,
    perpendicular,
    rounded,
    towards,
    turn,
    unit,
)
from mitsuba_ref.shapes.targets import Rng

MATERIALS: Fields = {"glass": {"type": "glass", "ior": 1.5}, "mirror": {"type": "mirror"}}
INNER_SHARE = 0.5  # radius of the inner sphere, unless stressed


def leaving_scene(shapes: list[Fields], distance: float, angle: float = 0.0) -> HardScene:
    """Rays from a distance to points of the shapes, from all directions, or at an angle to the surface."""

    def aim(rng: Rng, packed: Packed, count: int) -> RayBatch:
        p, _, across = Targets(packed, rng).points(count, "inside")
        back = directions(rng, count)
        if angle:
            n = unit(across)
            back = np.cos(angle) * perpendicular(rng, n) + np.sin(angle) * n
        return batch(*towards(p + distance * back, p))

    return HardScene(plain({**NO_VIEW, "material": MATERIALS, "shape": shapes}), aim)


def nested(center: np.ndarray, radius: float, inner: float) -> list[Fields]:
    """A sphere of glass within another one."""
    sphere: dict[str, Any] = {"type": "sphere", "center": rounded(center), "material": "glass"}
    return [sphere | {"radius": radius}, sphere | {"radius": inner}]


def gap(rng: Rng, width: float) -> HardScene:
    return leaving_scene(nested(near_origin(rng), 1.0, 1.0 - width), EYE_DISTANCE)


def with_mesh(rng: Rng, center: np.ndarray, radius: float) -> list[Fields]:
    """Nested spheres, and triangles of glass beside them."""
    beside = icosphere(rng, center + 2.5 * radius * directions(rng, 1)[0], radius)
    return [*nested(center, radius, INNER_SHARE * radius), beside | {"material": "glass"}]


def of_size(rng: Rng, size: float) -> HardScene:
    return leaving_scene(with_mesh(rng, size * near_origin(rng), size), EYE_DISTANCE * size)


def away(rng: Rng, offset: float) -> HardScene:
    return leaving_scene(with_mesh(rng, offset * directions(rng, 1)[0], 1.0), EYE_DISTANCE)


def grazing_mirrors(rng: Rng, angle: float) -> HardScene:
    """A sphere and two triangles that do not hide each other."""
    place = [turn(rng), {"translate": near_origin(rng)}]
    shapes: list[Fields] = [{"type": kind, "material": "mirror"} for kind in ("sphere", "rectangle")]
    steps = [place, [*place, {"translate": [100.0, 0.0, 0.0]}]]
    return leaving_scene(
        [shape | {"to_world": at} for shape, at in zip(shapes, steps, strict=True)], EYE_DISTANCE, angle
    )


SIZES = decades(-12, -9, -6, -5, -4, -3, -2, -1, 0, 3, 6, 9, 12)

SPAWNED: tuple[Family, ...] = (
    Family(
        "spawn-gap",
        "how near a second surface is: two spheres of glass, one within the other",
        gap,
        "distance of the spheres over radius",
        (*TINY[1:4], 4e-5, *TINY[4:]),
        0.1,
        spawns=True,
    ),
    Family(
        "spawn-scale",
        "the size of a scene that rays leave",
        of_size,
        "radius, scene units",
        SIZES,
        fits_float32=False,  # Mitsuba takes a sphere of radius 5e-13 for a stretched one
        spawns=True,
    ),
    Family("spawn-offset", "how far from the origin rays leave", away, OFFSET, TENFOLD, spawns=True),
    Family(
        "spawn-grazing",
        "how nearly rays leave a sphere or two triangles along them",
        grazing_mirrors,
        ANGLE,
        UP_TO_ONE[1:],
        spawns=True,
    ),
)

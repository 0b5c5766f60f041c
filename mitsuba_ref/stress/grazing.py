"""Grazing angle: rays that run nearly along a flat surface."""

from typing import Any

import numpy as np

from caster.shapes import Disk, Rectangle
from mitsuba_ref.stress.aiming import (
    Rays,
    across,
    chosen,
    crosses_triangles,
    part_of,
    scene_of,
    towards,
    turn,
)
from mitsuba_ref.stress.family import Family, Rng, Setting

DISTANCE = 5.0  # half sides
ANGLES = (1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)
REACH = 1.3  # half sides around the middle that rays are aimed at: four in ten go beyond the rim


def along(rng: Rng, angle: float, axes: np.ndarray, center: np.ndarray, many: int) -> Rays:
    """Rays to points of the plane through `center` that axes[0], axes[1] span, at an angle to it."""
    aim = center + rng.uniform(-REACH, REACH, (many, 2)) @ axes[:2]
    n = np.tile(axes[2] / np.linalg.norm(axes[2]), (many, 1))
    back = np.cos(angle) * across(rng, n) + rng.choice([-1.0, 1.0], (many, 1)) * np.sin(angle) * n
    return towards(aim + DISTANCE * back, aim)


def of_rectangle(rng: Rng, angle: float, count: int) -> Setting:
    scene = scene_of(Rectangle(to_world=place(rng)))
    corners = part_of(scene).vertices
    center = corners.mean(axis=0)
    first, second = 0.5 * (corners[1] - corners[0]), 0.5 * (corners[3] - corners[0])
    axes = np.stack([first, second, np.cross(first, second)])
    hits = crosses_triangles(corners[part_of(scene).faces])
    return Setting(angle, scene, *chosen(lambda many: along(rng, angle, axes, center, many), hits, count))


def of_disk(rng: Rng, angle: float, count: int) -> Setting:
    scene = scene_of(Disk(to_world=place(rng)))
    part = part_of(scene)

    def hits(o: np.ndarray, d: np.ndarray) -> np.ndarray:
        f, e = (o - part.center[0]) @ part.to_object[0].T, d @ part.to_object[0].T
        with np.errstate(all="ignore"):
            q = f - (f[:, 2:] / e[:, 2:]) * e
        return np.hypot(q[:, 0], q[:, 1]) <= 1.0

    axes = part.to_world[0].T
    return Setting(
        angle, scene, *chosen(lambda many: along(rng, angle, axes, part.center[0], many), hits, count)
    )


def place(rng: Rng) -> list[dict[str, Any]]:
    return [turn(rng), {"translate": rng.normal(scale=0.3, size=3)}]


RECTANGLE = Family(
    "grazing-rectangle",
    "rays that run nearly along two triangles",
    "angle between ray and surface, radians",
    ANGLES,
    ANGLES[-1],
    of_rectangle,
)
DISK = Family(
    "grazing-disk",
    "rays that run nearly along a disk",
    "angle between ray and surface, radians",
    ANGLES,
    ANGLES[-1],
    of_disk,
)

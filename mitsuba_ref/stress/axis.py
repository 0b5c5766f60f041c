"""A cylinder nearly along its axis: rays inside a long tube that meet its wall at a small angle."""

from typing import Any

import numpy as np

from caster.shapes import Cylinder
from mitsuba_ref.stress.aiming import Rays, across, chosen, float32, part_of, scene_of, unit
from mitsuba_ref.stress.family import Family, Rng, Setting

ANGLES = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)
LONG = (
    4.0  # length of the tube, in radii over the angle: a ray from the axis comes to the wall after a quarter
)


def make(rng: Rng, angle: float, count: int) -> Setting:
    """Half of the rays go the long way from near one end, half leave by an end that is too near."""
    axis = across(rng, np.array([[0.3, 0.5, 0.8]]))[0] * (LONG / angle)
    scene = scene_of(Cylinder(p0=tuple(-0.5 * axis), p1=tuple(0.5 * axis), radius=1.0))
    part = part_of(scene)

    def candidates(many: int) -> Rays:
        turned = rng.uniform(0.0, 2.0 * np.pi, many)
        height = np.where(rng.random(many) < 0.6, rng.uniform(0.05, 0.5, many), rng.uniform(0.7, 0.95, many))
        start = np.column_stack([*rng.uniform(-0.3, 0.3, (2, many)), height])
        lean = np.column_stack([np.cos(turned), np.sin(turned), np.full(many, 1.0 / LONG)])
        matrix = part.to_world[0].T
        return float32(part.center[0] + start @ matrix), float32(unit(lean @ matrix))

    return Setting(angle, scene, *chosen(candidates, lambda o, d: reaches_wall(part, o, d), count))


def reaches_wall(part: Any, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Whether rays from within the tube meet its wall before its end."""
    f, e = (o - part.center[0]) @ part.to_object[0].T, d @ part.to_object[0].T
    a, b = (e[:, :2] ** 2).sum(axis=1), (f[:, :2] * e[:, :2]).sum(axis=1)
    c = (f[:, :2] ** 2).sum(axis=1) - 1.0
    with np.errstate(all="ignore"):
        z = f[:, 2] + (np.sqrt(b * b - a * c) - b) / a * e[:, 2]
    found: np.ndarray = (z >= 0.0) & (z <= 1.0)
    return found


FAMILY = Family(
    "axis",
    "rays inside a tube, nearly along its axis",
    "angle between ray and axis, radians",
    ANGLES,
    ANGLES[-1],
    make,
)

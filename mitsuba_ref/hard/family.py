"""Families of hard scenes: a name, at most one swept quantity, and a function that makes a scene and aims rays."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from caster.geometry.packing import Packed
from caster.scene.model import Scene
from mitsuba_ref.error_model.intersections import Rays
from mitsuba_ref.shapes.shape_reference import Fields
from mitsuba_ref.shapes.targets import Rng

AimRays = Callable[[Rng, Packed, int], Rays]  # of the packed scene; so many rays, or fewer if a family has no more


class HardScene(NamedTuple):
    """A scene as a scene file describes it, and a function that aims rays at its packed shapes."""

    data: Fields
    aim: AimRays

    def scene(self) -> Scene:
        return scene_of(self.data)


def plain(data: Fields) -> Fields:
    """A copy with lists in place of NumPy arrays, as in a scene file."""
    return json.loads(json.dumps(data, default=lambda array: array.tolist()))


def scene_of(data: Fields) -> Scene:
    """The scene that the data describe. Raises SceneError or pydantic's ValidationError."""
    return Scene.model_validate(plain(data))


@dataclass(frozen=True)
class Family:
    """Scenes of one numerical difficulty.

    `stress` sweeps the families that have values: one quantity becomes extreme. `fuzz` draws a family, and one of
    its values.
    """

    name: str
    title: str  # what makes it hard, in a line
    make: Callable[[Rng, float], HardScene] = field(repr=False)  # of the swept quantity, 0.0 where there is none
    quantity: str = ""  # the swept one, with its unit
    values: tuple[float, ...] = ()  # of it, in ascending order
    easiest: float = 1.0  # scenes get harder away from this value
    unit: float | None = None  # errors of t are divided by this radius; None: by the distance
    closed: bool = False  # every ray starts inside a closed mesh, so that each of them hits
    fits_float32: bool = True  # so that Mitsuba can trace it
    always_judged: bool = False  # `fuzz` compares each of its scenes with Mitsuba, unless it compares none

    @property
    def error(self) -> str:
        return "relative error of t" if self.unit is None else "error of t over radius"

    def at(self, seed: int, value: float) -> tuple[HardScene, Rng]:
        """One setting of a sweep and its random numbers, which do not depend on what else is swept."""
        rng = np.random.default_rng([seed, *self.name.encode(), *np.float64(value).tobytes()])
        return self.make(rng, value), rng

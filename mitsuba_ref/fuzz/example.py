"""Example i of seed S: a scene and rays, the same whenever and wherever they are asked for."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from caster.packing import Packed
from caster.scene import Scene
from mitsuba_ref.fuzz import cameras
from mitsuba_ref.fuzz.aims import Shots, aimed
from mitsuba_ref.fuzz.families import Family, number_of
from mitsuba_ref.fuzz.setting import Rng, Setting
from mitsuba_ref.fuzz.spots import Targets

RAYS = 40  # of an example, before those with limits


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
        return np.random.default_rng([self.seed, self.number, number_of(self.family), purpose])

    def shots(self, packed: Packed, rays: int = RAYS) -> Shots:
        """The rays to cast."""
        return aimed(self.random(AIMING), Targets(packed), self.setting, rays, self.family.aims)


DRAWING, AIMING, LIMITING, CHOOSING = range(4)  # purposes


def example(seed: int, number: int, families: Sequence[Family]) -> Example:
    """Families take turns, so a family that is asked for alone has other examples of the same numbers."""
    family = families[number % len(families)]
    rng = np.random.default_rng([seed, number, number_of(family), DRAWING])
    setting, shapes = family.draw(rng)
    film, camera = cameras.drawn(rng, setting, family.cameras, family.films)
    return Example(seed, number, family, setting, {"film": film, "camera": camera, "shape": shapes})


def scene_of(data: dict[str, Any]) -> Scene:
    """Raises SceneError, or pydantic's ValidationError, for what is no scene."""
    scene: Scene = Scene.model_validate(data)
    return scene

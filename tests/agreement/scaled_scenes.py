"""Scenes scaled by powers of two."""

from typing import Any

import numpy as np

from caster.scene.model import Scene

# Fields of cameras that are lengths. t_max counts in lengths of the direction of a camera of type `ray`, which stays.
LENGTHS = ("eye", "look_at", "origin", "near", "far", "width", "t_max")


def scaled_scene(scene: Scene, exponent: int) -> Scene:
    """The scene 2^exponent times as large, seen from as many times as far: lights reach it as before."""
    factor = 2.0**exponent
    lights = []
    for light in scene.lights:
        if hasattr(light, "position"):  # a point light sends factor^2 as much, so that the same arrives
            brighter = {"intensity": np.multiply(factor * factor, light.intensity)}
            light = _with_lengths(light, factor, ("position",)).model_copy(update=brighter)
        lights.append(light)
    shapes = tuple(each.model_copy(update={"to_world": (*each.to_world, {"scale": factor})}) for each in scene.shapes)
    camera = _with_lengths(scene.camera, factor, LENGTHS)
    return scene.model_copy(update={"camera": camera, "lights": tuple(lights), "shapes": shapes})


def _with_lengths(element: Any, factor: float, names: tuple[str, ...]) -> Any:
    """A copy with the named fields multiplied, those of them that are set."""
    given = {name: getattr(element, name, None) for name in names}
    return element.model_copy(update={name: np.multiply(factor, x) for name, x in given.items() if x is not None})

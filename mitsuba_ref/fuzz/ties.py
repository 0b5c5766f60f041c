"""Surfaces in one place: which of them is hit is a matter of their numbers alone."""

import copy
from collections.abc import Callable
from typing import Any

import numpy as np

from mitsuba_ref.fuzz.setting import Rng, Setting, nudged
from mitsuba_ref.fuzz.shapes import TYPES, drawn, triangle_of

Shape = dict[str, Any]
Shapes = list[Shape]


def tied(rng: Rng, setting: Setting) -> Shapes:
    """A few shapes that coincide, in random order, with something else among them."""
    shapes = WAYS[rng.integers(len(WAYS))](rng, setting)
    if rng.random() < 0.5:
        shapes.append(drawn(rng, str(rng.choice(TYPES)), setting))
    return [shapes[i] for i in rng.permutation(len(shapes))]


def copies(rng: Rng, setting: Setting) -> Shapes:
    """The same shape two to six times."""
    shape = drawn(rng, str(rng.choice(TYPES)), setting)
    return [copy.deepcopy(shape) for _ in range(int(rng.integers(2, 7)))]


def nearly_equal_balls(rng: Rng, setting: Setting) -> Shapes:
    """One centre, and radii that differ by a unit in the last place or not at all."""
    center = np.array(setting.middle) + setting.size * setting.snapped(rng.uniform(-1.0, 1.0, 3))
    radius = setting.size * float(rng.choice([1.0, 0.625, rng.uniform(0.1, 1.0)]))
    return [
        {"type": "sphere", "center": center.tolist(), "radius": abs(float(nudged(rng, np.array(radius), 1)))}
        for _ in range(int(rng.integers(2, 7)))
    ]


def one_square(rng: Rng, setting: Setting) -> Shapes:
    """The square [-1, 1]^2 as a rectangle, two triangles, a plane, the side of a cube, and with a disk in it."""
    step = [{"scale": setting.size}, {"translate": list(setting.middle)}]
    below = [{"translate": [0.0, 0.0, -1.0]}, *step]
    corners = np.array(setting.middle) + setting.size * np.array(
        [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    )
    shapes: Shapes = [
        {"type": "rectangle", "to_world": step},
        {"type": "disk", "to_world": step},
        {"type": "cube", "to_world": below},
        {"type": "plane", "normal": [0.0, 0.0, 1.0], "point": list(setting.middle)},
        {"type": "plane", "normal": [0.0, 0.0, -1.0], "point": corners[1].tolist()},
        triangle_of(corners[[0, 1, 2]]),
        triangle_of(corners[[3, 2, 0]]),
    ]
    return [shapes[i] for i in rng.choice(len(shapes), int(rng.integers(2, 6)), replace=False)]


def turned_over(rng: Rng, setting: Setting) -> Shapes:
    """A triangle with its corners in all six orders."""
    corners = setting.snapped(np.array(setting.middle) + setting.size * rng.uniform(-1.0, 1.0, (3, 3)))
    return [triangle_of(rng.permutation(corners)) for _ in range(int(rng.integers(2, 7)))]


def touching(rng: Rng, setting: Setting) -> Shapes:
    """A ball, a tube of its radius and a disk in its equator: they meet in a circle and in points."""
    step = [{"scale": setting.size}, {"translate": list(setting.middle)}]
    beside = [{"translate": [2.0, 0.0, 0.0]}, *step]
    kinds = rng.permutation(["sphere", "cylinder", "disk"])
    shapes: Shapes = [{"type": str(kind), "to_world": step} for kind in kinds]
    return [*shapes, {"type": "sphere", "to_world": beside}]


WAYS: tuple[Callable[[Rng, Setting], Shapes], ...] = (
    copies,
    nearly_equal_balls,
    one_square,
    turned_over,
    touching,
)

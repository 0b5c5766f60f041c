"""Hypothesis strategies of hard scenes and rays: the catalogue that `mitsuba-ref fuzz` draws from.

They need Hypothesis: pip install hypothesis.
"""

from collections.abc import Callable, Collection
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from caster.geometry.packing import packed
from caster.scene.model import Scene
from mitsuba_ref.fuzz.checks import SCENE_ERRORS
from mitsuba_ref.fuzz.fuzz_run import Example
from mitsuba_ref.hard import BY_NAME
from mitsuba_ref.hard.family import scene_of
from mitsuba_ref.hard.random_parts import shape_types
from mitsuba_ref.shapes import REFERENCES

try:
    from hypothesis import reject
    from hypothesis import strategies as st
except ImportError as error:
    raise ImportError("mitsuba_ref.strategies needs Hypothesis: pip install hypothesis") from error

__all__ = ["TRIANGLES", "SceneWithRays", "rays", "scenes"]

TRIANGLES = tuple(each.type_name for each in REFERENCES.values() if hasattr(each.describes, "mesh"))
FAMILIES = tuple(name for name, family in BY_NAME.items() if family.fits_float32)
EXAMPLES_TRIED = 4  # of a family, which is left out if none of them has a shape of the requested types
SEEDS = st.integers(0, 2**32 - 1)


class SceneWithRays(NamedTuple):
    """A scene, and rays through it: o, d (n, 3) float64, d of any length."""

    scene: Scene
    o: NDArray[np.float64]
    d: NDArray[np.float64]


def scenes(shapes: Collection[str] = shape_types(), families: Collection[str] = FAMILIES) -> st.SearchStrategy[Scene]:
    """Hard scenes: surfaces that coincide, slivers, shapes far from the origin, mirrored and stretched ones, ...

    shapes: types of shapes to draw, all by default; TRIANGLES: those that are made of triangles. families: names, as
    `mitsuba-ref fuzz --family` takes them. A failing example shrinks to few shapes. The first example
    raises KeyError for an unknown family.
    """
    return rays(shapes, families, most=1).map(lambda drawn: drawn.scene)


def rays(
    shapes: Collection[str] = shape_types(), families: Collection[str] = FAMILIES, most: int = 40
) -> st.SearchStrategy[SceneWithRays]:
    """Hard scenes as `scenes` draws them, each with up to `most` rays at its edges, corners, rims and tangents.

    A failing example shrinks to few shapes and one ray.
    """
    return _drawn(tuple(shapes), tuple(families), most)


@cache
def _families_with(types: tuple[str, ...], names: tuple[str, ...]) -> list[str]:
    tried = (Example(0, number, BY_NAME[name], types) for name in names for number in range(EXAMPLES_TRIED))
    return [*dict.fromkeys(each.family.name for each in tried if each.made.data["shape"])]


@st.composite
def _drawn(draw: Callable[..., Any], types: tuple[str, ...], names: tuple[str, ...], most: int) -> SceneWithRays:
    name = draw(st.sampled_from(_families_with(types, names)))
    made = Example(0, draw(SEEDS), BY_NAME[name], types).made
    shapes, seeds = made.data["shape"], draw(st.lists(SEEDS, min_size=1, max_size=most))
    # `chosen` is drawn in either case, so that an example can shrink to few shapes without further choices
    drops_shapes, chosen = draw(st.integers(0, 3)) == 0, [draw(st.booleans()) for _ in shapes]
    if drops_shapes:
        shapes = [each for each, kept in zip(shapes, chosen, strict=True) if kept] or shapes[-1:]
    try:
        scene, whole = scene_of({**made.data, "shape": shapes}), packed(made.scene())
    except SCENE_ERRORS:
        reject()
    if not shapes:
        reject()
    batches = [made.aim(np.random.default_rng(seed), whole, 1) for seed in seeds]  # the same whichever shapes are left
    o, d = (np.concatenate(columns) for columns in zip(*(batch[:2] for batch in batches), strict=True))
    return SceneWithRays(scene, o, d)

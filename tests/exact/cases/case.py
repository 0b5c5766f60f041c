"""What an edge case is made of: questions, each one scene and rays into it, in float64 or in float32 numbers."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from places import scene_of

from caster import Scene
from caster.geometry.packing import pack
from caster.geometry.world_space import Rounding, as_float32, as_given

MORE = "EDGE_CASE_RAYS"  # environment variable: so many times as many rays


class Precision(NamedTuple):
    """The numbers that a scene and its rays are made of."""

    name: str
    rounded: Rounding
    dtype: type


FLOAT64 = Precision("float64", as_given, np.float64)
FLOAT32 = Precision("float32", as_float32, np.float32)
PRECISIONS = (FLOAT64, FLOAT32)


class Question(NamedTuple):
    """Rays into one scene. `wants`: of what is met, at least so many; `never`: what must not be met at all."""

    name: str
    scene: Scene
    o: np.ndarray  # (n, 3) float64
    d: np.ndarray  # (n, 3) float64
    t_min: float
    t_max: float
    wants: Mapping[str, int]
    never: tuple[str, ...]


Questions = Iterator[Question]


class Maker:
    """Makes the questions of one case in one precision: the same numbers in every run."""

    def __init__(self, number: int, precision: Precision) -> None:
        self.precision = precision
        self.rng = np.random.default_rng([number, PRECISIONS.index(precision)])
        self.more = float(os.environ.get(MORE) or 1.0)

    @property
    def single(self) -> bool:
        return self.precision is FLOAT32

    def rounded(self, numbers: Any) -> np.ndarray:
        with np.errstate(over="ignore", under="ignore"):
            return self.precision.rounded(np.asarray(numbers, np.float64))

    def count(self, rays: int) -> int:
        return max(int(rays * self.more), 1)

    def beside(self, numbers: Any, steps: int) -> np.ndarray:
        """The numbers some units in the last place up (steps > 0) or down (steps < 0)."""
        moved = np.asarray(numbers).astype(self.precision.dtype)
        for _ in range(abs(steps)):
            moved = np.nextafter(moved, self.precision.dtype(np.copysign(np.inf, steps)))
        return moved.astype(np.float64)

    def scene(self, shapes: Sequence[Any]) -> Scene:
        """A scene whose packed numbers have this precision."""
        scene = scene_of(*shapes, film={"width": 1, "height": 1})
        scene.derived["packed"] = pack(scene, self.rounded)
        return scene

    def ask(
        self,
        name: str,
        scene: Scene | Sequence[Any],
        o: Any,
        d: Any,
        *,
        t_min: float = 0.0,
        t_max: float = np.inf,
        never: tuple[str, ...] = (),
        **wants: int,
    ) -> Question:
        """o, d: (n, 3) or (3,); they are rounded, and rays whose direction rounds to nothing are left out."""
        scene = scene if isinstance(scene, Scene) else self.scene(scene)
        o, d = np.broadcast_arrays(*(self.rounded(np.atleast_2d(a)) for a in (o, d)))
        kept = np.flatnonzero(d.any(axis=1) & np.isfinite(o).all(axis=1) & np.isfinite(d).all(axis=1))
        if not len(kept):
            raise ValueError(f"{name}: no ray is left")
        return Question(name, scene, o[kept].copy(), d[kept].copy(), t_min, t_max, wants, never)


@dataclass(frozen=True)
class Case:
    """One edge case and its questions."""

    number: int  # its row in docs/internals/edge-cases.md
    name: str
    questions: Callable[[Maker], Questions]
    every_shape: bool = False  # whether it is asked of every shape of the registry

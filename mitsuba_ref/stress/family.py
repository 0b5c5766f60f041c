"""What is stressed, and how: a family of settings that get harder and harder."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from caster.cameras import Pinhole
from caster.scene import Film, Scene

Rng = np.random.Generator

# How many rays a setting has unless told; in a closed mesh, exact arithmetic need not look at all of them.
RAYS, CLOSED_RAYS = 400, 10_000


class Shot(NamedTuple):
    """Rays of a setting that share an eye and a film: ours casts them through the screen, too."""

    camera: Pinhole
    film: Film
    rays: np.ndarray  # (m,) which of the setting's rays
    pixels: (
        np.ndarray
    )  # (m,) the pixel of the film's window that each goes through, row by row; all different


@dataclass(frozen=True, eq=False)
class Setting:
    """One point of a sweep: a scene, and rays of float32 numbers through it, for everybody."""

    x: float  # the stressed quantity
    scene: Scene
    o: np.ndarray  # (n, 3) float32
    d: np.ndarray  # (n, 3) float32
    unit: float | None = None  # what errors are measured in, scene units; None: relative to the distance
    shots: Sequence[Shot] = ()
    closed: bool = False  # every ray starts inside a closed mesh, so that each of them hits


@dataclass(frozen=True)
class Family:
    """One sweep. `settings(rng of each x, rays)` begins with the easiest, or with the smallest x."""

    name: str
    title: str  # what is stressed, in a line
    quantity: str  # the x axis, with its unit
    values: tuple[float, ...]  # of x, in ascending order
    easiest: float  # the value of x from where on it gets harder, to one side or to both
    make: Callable[[Rng, float, int], Setting] = field(repr=False)
    error: str = "relative error of t"
    misses: bool = True  # whether exact misses have to be among the answers, beside hits
    rays: int = RAYS

    def settings(self, seed: int, rays: int | None) -> Iterator[Setting]:
        """Every setting by a seed of its own: none depends on which others are asked for."""
        for value in self.values:
            rng = np.random.default_rng([seed, *self.name.encode(), *np.float64(value).tobytes()])
            yield self.make(rng, value, rays or self.rays)

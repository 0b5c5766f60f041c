"""Our own surface, held to float64: what exact arithmetic does not speak of once the primitive and its t are right."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mitsuba_ref.bounds import Bounds
from mitsuba_ref.pair import Pair
from mitsuba_ref.pixels import apart, flat


class Held(NamedTuple):
    """One quantity at all pixels."""

    name: str
    error: np.ndarray  # (n,) how far ours is from our own primitive's
    bound: np.ndarray  # (n,) what float64 allows
    counts: np.ndarray  # (n,) bool: where it is held to that

    @property
    def beyond(self) -> np.ndarray:
        """(n,) bool."""
        found: np.ndarray = self.counts & ~(self.error <= self.bound)
        return found

    def is_beyond(self, row: int) -> bool:
        """At one of them."""
        return bool(self.counts[row]) and not self.error[row] <= self.bound[row]


def held(pair: Pair, bounds: Bounds, point: np.ndarray) -> Iterator[Held]:
    """Normals and position of the pixels that we hit. point: (n, 3) o + t d.

    Where float64 does not resolve t, the point and the shading normal, which follow from it, are not held to anything;
    the geometric normal is.
    """
    own, hit = bounds.own, pair.prim >= 0
    resolved = hit & np.isfinite(own.t_error)
    yield Held("normal", apart(flat(pair.ours, "normal"), own.n), own.n_error, hit)
    yield Held("shading_normal", apart(flat(pair.ours, "shading_normal"), own.sh_n), own.sh_error, resolved)
    yield Held("position", apart(flat(pair.ours, "position"), point), own.p_error, resolved)


def beyond_float64(held: Sequence[Held]) -> np.ndarray:
    """(n,) bool: pixels where something of ours is farther from our primitive's than float64 allows."""
    found: np.ndarray = np.any([each.beyond for each in held], axis=0)
    return found

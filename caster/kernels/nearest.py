"""Rays, and the record of the nearest hit of each."""

from typing import Any, NamedTuple

import numpy as np

from caster.kernels.jit import jit


class Rays(NamedTuple):
    """Points o + t d with t_min < t <= t_max."""

    o: np.ndarray  # (n, 3) float64
    d: np.ndarray  # (n, 3) float64
    t_min: np.ndarray  # (n,) float64
    t_max: np.ndarray  # (n,) float64; < 0: there is no ray


class Nearest(NamedTuple):
    """What each ray meets first."""

    t: np.ndarray  # (n,) float64, inf on a miss
    prim: np.ndarray  # (n,) int32, number of the primitive in the scene, -1 on a miss


def no_hits(count: int) -> Nearest:
    return Nearest(np.full(count, np.inf), np.full(count, -1, np.int32))


@jit
def keep_nearer(nearest: Any, i: int, t: float, prim: int, t_max: float) -> None:
    """Fold a hit into the record of ray i by the total order (t, prim), so that no order of work shows."""
    if t <= t_max and (t < nearest.t[i] or (t == nearest.t[i] and prim < nearest.prim[i])):
        nearest.t[i] = t
        nearest.prim[i] = prim

"""Rays, and the record of the nearest hit of each: fast, with doubts noted, or exact."""

import math
from typing import Any, NamedTuple

import numpy as np

from caster.kernels.exact_root import FLOAT_ERROR, as_float, order
from caster.kernels.jit import implement, jit
from caster.kernels.protocol import keep_nearer, root
from caster.kernels.vec import row


class Rays(NamedTuple):
    """Points o + t d with t_min < t <= t_max."""

    o: np.ndarray  # (n, 3) float64
    d: np.ndarray  # (n, 3) float64
    t_min: np.ndarray  # (n,) float64
    t_max: np.ndarray  # (n,) float64; < 0: there is no ray


class Nearest(NamedTuple):
    """What each ray meets first: exactly that, though t is a float64."""

    t: np.ndarray  # (n,) float64, inf on a miss
    prim: np.ndarray  # (n,) int32, number of the primitive, -1 on a miss
    off: np.ndarray  # (n,) float64, the true t is within off of t


class Sketch(NamedTuple):
    """Nearest in the making, as far as float64 can tell."""

    t: np.ndarray
    prim: np.ndarray
    off: np.ndarray
    doubt: np.ndarray  # (n,) bool: something else may come first
    ids: np.ndarray  # (k,) int32, numbers in the scene of the primitives that are being cast at


def new_rays(count: int) -> Rays:
    """Room for so many."""
    return Rays(np.empty((count, 3)), np.empty((count, 3)), np.empty(count), np.empty(count))


def no_hits(count: int) -> Nearest:
    return Nearest(np.full(count, np.inf), np.full(count, -1, np.int32), np.zeros(count))


@implement(keep_nearer, Sketch)
def _keep_nearer(record: Any, i: int, prims: Any, k: int, rays: Any, hit: tuple[float, float]) -> None:
    """Without a branch: around one, Numba counts references to every array of the record, 30 ns a hit."""
    t, off = hit
    ahead, margin = record.t[i] - t if t < math.inf else -math.inf, record.off[i] + off
    nearer = ahead > margin
    record.doubt[i] |= abs(ahead) <= margin
    record.t[i] = t if nearer else record.t[i]
    record.prim[i] = record.ids[k] if nearer else record.prim[i]
    record.off[i] = off if nearer else record.off[i]


@implement(keep_nearer, Nearest)
def _keep_nearer_exactly(
    record: Any, i: int, prims: Any, k: int, rays: Any, hit: tuple[float, float]
) -> None:
    t, off = hit
    if t == math.inf or t - off > record.t[i] + record.off[i]:
        return
    held, sure = record.prim[i], off < math.inf
    if not t + off < record.t[i] - record.off[i] and not (held < 0 and sure):
        if not rays.t_min[i] < rays.t_max[i]:
            return
        new = exact_hit(prims, k, rays, i)
        if not new.hit or (held >= 0 and not precedes(new, k, exact_hit(prims, held, rays, i), held)):
            return
        if not sure:
            t = as_float(new)
            off = FLOAT_ERROR * t
    record.t[i], record.prim[i], record.off[i] = t, k, off


@jit
def exact_hit(prims: Any, k: int, rays: Any, i: int) -> Any:
    """Where ray i meets primitive k."""
    return root(prims, k, row(rays.o, i), row(rays.d, i), rays.t_min[i], rays.t_max[i])


@jit
def precedes(x: Any, k: int, y: Any, j: int) -> bool:
    """Whether root x of primitive k comes before root y of primitive j."""
    first = order(x, y)
    return first < 0 or (first == 0 and k < j)


@jit
def merge(nearest: Any, found: Any, ids: Any, contested: Any, start: int, stop: int) -> None:
    """Fold the record of one kind into that of all, where float64 can tell; ids[k] is the number in the scene."""
    for i in range(start, stop):
        if found.prim[i] < 0:
            continue
        t, off = found.t[i], found.off[i]
        if t + off < nearest.t[i] - nearest.off[i]:
            nearest.t[i], nearest.prim[i], nearest.off[i] = t, ids[found.prim[i]], off
        elif t - off <= nearest.t[i] + nearest.off[i]:
            contested[i] = True

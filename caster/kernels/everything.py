"""Culling 0: none. Every ray against every primitive, the slow and obvious oracle of the other two."""

from typing import Any

from caster.kernels.jit import jit
from caster.kernels.nearest import keep_nearer
from caster.kernels.protocol import intersect, prepare
from caster.kernels.vec import row


@jit
def cast_everything(prims: Any, ids: Any, rays: Any, nearest: Any, start: int, stop: int) -> None:
    """Rays start..stop against all primitives of a kind; ids[k] is the number of primitive k in the scene."""
    for i in range(start, stop):
        o, d = row(rays.o, i), row(rays.d, i)
        for k in range(len(ids)):
            t = intersect(prims, prepare(prims, k, o), d, rays.t_min[i])
            keep_nearer(nearest, i, t, ids[k], rays.t_max[i])

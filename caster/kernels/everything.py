"""Culling 0: none. Every ray against every primitive, the slow and obvious oracle of the other two."""

from typing import Any

from caster.kernels.jit import jit
from caster.kernels.protocol import intersect, keep_nearer, prepare
from caster.kernels.vec import row


@jit
def cast_everything(prims: Any, count: int, rays: Any, record: Any, start: int, stop: int) -> None:
    """Rays start..stop against all `count` primitives of a kind."""
    for i in range(start, stop):
        o, d = row(rays.o, i), row(rays.d, i)
        for k in range(count):
            hit = intersect(prims, prepare(prims, k, o), d, rays.t_min[i], rays.t_max[i])
            keep_nearer(record, i, prims, k, rays, hit)

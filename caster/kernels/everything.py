"""Culling 0: none. Every ray against every primitive, the slow and obvious oracle of the other two."""

import math
from typing import Any

from caster.kernels.jit import jit
from caster.kernels.protocol import intersect, keep_nearer, prepare


@jit
def cast_everything(prims: Any, count: int, rays: Any, record: Any, start: int, stop: int) -> None:
    """Rays start..stop against all `count` primitives of a kind."""
    for i in range(start, stop):
        o, d = (rays.o[i, 0], rays.o[i, 1], rays.o[i, 2]), (rays.d[i, 0], rays.d[i, 1], rays.d[i, 2])
        for k in range(count):
            hit = intersect(prims, prepare(prims, k, o), d, rays.t_min[i], rays.t_max[i])
            if hit[0] < math.inf:
                keep_nearer(record, i, prims, k, rays, hit)

"""Culling 0: none. Every ray against every primitive, the slow and obvious oracle of the other two."""

from typing import Any

from caster.kernels.jit import jit
from caster.kernels.protocol import intersect, nearer, note, numbers, passes, prepare, recall


@jit
def cast_everything(mode: Any, prims: Any, count: int, rays: Any, record: Any, start: int, stop: int) -> None:
    """Rays start..stop against all `count` primitives of a kind; rays in a row from one origin share `prepare`."""
    if start >= stop:
        return
    for k in range(count):
        o = rays.o[start, 0], rays.o[start, 1], rays.o[start, 2]
        prim = numbers(prims, k)
        pre = prepare(prims, prim, o)
        for i in range(start, stop):
            if rays.o[i, 0] != o[0] or rays.o[i, 1] != o[1] or rays.o[i, 2] != o[2]:
                o = rays.o[i, 0], rays.o[i, 1], rays.o[i, 2]
                pre = prepare(prims, prim, o)
            d, t_min, t_max = (rays.d[i, 0], rays.d[i, 1], rays.d[i, 2]), rays.t_min[i], rays.t_max[i]
            if passes(prims, pre, d):
                continue
            hit = intersect(prims, pre, d, t_min, t_max)
            best = nearer(mode, recall(mode, record, i), i, k, hit)
            note(mode, record, i, best)

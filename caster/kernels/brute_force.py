"""Brute force: every ray against every primitive, the slow and obvious oracle of rasterization and BVHs."""

from typing import Any

from caster.jit.decorators import jit
from caster.kernels.math.vec import row
from caster.kernels.protocol import (
    intersect,
    load,
    load_best,
    prepare,
    store_best,
    surely_misses,
    update_best,
)


@jit
def cast_brute_force(
    mode: Any, prims: Any, count: int, rays: Any, record: Any, start: int, stop: int
) -> None:
    """Rays start..stop against all `count` primitives of a kind; rays in a row from one origin share `prepare`."""
    if start >= stop:
        return
    for k in range(count):
        o = rays.o[start, 0], rays.o[start, 1], rays.o[start, 2]
        prim = load(prims, k)
        pre = prepare(prims, prim, o)
        for i in range(start, stop):
            if rays.o[i, 0] != o[0] or rays.o[i, 1] != o[1] or rays.o[i, 2] != o[2]:
                o = rays.o[i, 0], rays.o[i, 1], rays.o[i, 2]
                pre = prepare(prims, prim, o)
            d, t_min, t_max = (rays.d[i, 0], rays.d[i, 1], rays.d[i, 2]), rays.t_min[i], rays.t_max[i]
            if surely_misses(prims, pre, d):
                continue
            hit = intersect(prims, pre, d, t_min, t_max)
            best = update_best(mode, load_best(mode, record, i), i, k, hit)
            store_best(mode, record, i, best)


# One ray against single primitives: the answer of `intersect` for each, nothing folded, nothing skipped.


@jit
def intersect_each(prims: Any, ks: Any, rays: Any, t: Any, error: Any, start: int, stop: int) -> None:
    """t[j], off[j] of ray 0 and primitive ks[j], for j in start..stop; see protocol.intersect."""
    o, d = row(rays.o, 0), row(rays.d, 0)
    for j in range(start, stop):
        pre = prepare(prims, load(prims, ks[j]), o)
        t[j], error[j] = intersect(prims, pre, d, rays.t_min[0], rays.t_max[0])

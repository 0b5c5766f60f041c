"""One ray against single primitives: what `intersect` says of each, nothing folded, nothing skipped."""

from typing import Any

from caster.kernels.jit import jit
from caster.kernels.protocol import intersect, numbers, prepare
from caster.kernels.vec import row


@jit
def answer_each(prims: Any, ks: Any, rays: Any, t: Any, off: Any, start: int, stop: int) -> None:
    """t[j], off[j] of ray 0 and primitive ks[j], for j in start..stop; see protocol.intersect."""
    o, d = row(rays.o, 0), row(rays.d, 0)
    for j in range(start, stop):
        pre = prepare(prims, numbers(prims, ks[j]), o)
        t[j], off[j] = intersect(prims, pre, d, rays.t_min[0], rays.t_max[0])

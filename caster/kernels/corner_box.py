"""The box of a triangle's corners, and the part of a ray in it."""

import math
from typing import Any

from caster.kernels.jit import jit
from caster.kernels.protocol import Vec3
from caster.kernels.vec import MISS

# Rounding moves a corner by at most 6 u of its largest coordinate, seen from the origin, u = 2^-53: 3 u for
# the three differences that enter a sheared coordinate, 3 u for its two products and their difference. So a
# ray inside the triangle of the sheared corners passes the box of the true ones within 6 u. The tree widens
# boxes by 16 u (kernels/bvh.py), of which rounding takes 4; 8 u and 3 roundings here stay within the rest.
BOX_PADDING = 8.0 * 2.0**-53


@jit
def box_side(pre: Any, c: int) -> tuple[float, float]:
    """(low, high) coordinate c of the corners, seen from the origin and widened."""
    a, b, e = pre
    x = max(abs(a[0]), abs(a[1]), abs(a[2]))
    y = max(abs(b[0]), abs(b[1]), abs(b[2]))
    z = max(abs(e[0]), abs(e[1]), abs(e[2]))
    pad = BOX_PADDING * max(x, y, z)
    return min(a[c], b[c], e[c]) - pad, max(a[c], b[c], e[c]) + pad


@jit
def lies_in_box(pre: Any, d: Vec3, t: float) -> bool:
    """Whether t d lies in the box of the corners."""
    for c in range(3):
        low, high = box_side(pre, c)
        x = t * d[c]
        if x < low or x > high:
            return False
    return True


@jit
def moved_into_box(pre: Any, d: Vec3, t: float) -> float:
    """The t nearest to this one where t d lies in the box of the corners; MISS if there is none."""
    first, last = -math.inf, math.inf
    for c in range(3):
        low, high = box_side(pre, c)
        if d[c] == 0.0:
            if low > 0.0 or high < 0.0:
                return MISS
        else:
            x, y = low / d[c], high / d[c]
            first, last = max(first, min(x, y)), min(last, max(x, y))
    return min(max(t, first), last) if first <= last else MISS

"""Exact parameters along a ray, and their order: t = 2^e (p + s sqrt(r)) / q in integers."""

import math
from typing import Any, NamedTuple

import numpy as np

from caster.jit.decorators import jit
from caster.kernels.exact.integers import (
    Integer,
    integer,
    leading,
    lowest_exponent,
    minus,
    plus,
    shifted,
    sign,
    signed,
    times,
)

LARGEST_FLOAT = 1.7976931348623157e308

# as_float: each of p, q, r is read within 2 u; a square root, a sum of numbers of one sign, a product and a quotient
# round once each. At most 9 u add up; u = 2^-53.
AS_FLOAT_REL_ERROR = 16.0 * 2.0**-53


class Root(NamedTuple):
    """t = 2^e (p + s sqrt(r)) / q, or nothing where not `hit`."""

    hit: bool
    p: Any  # Integer
    r: Any  # Integer >= 0
    q: Any  # Integer > 0
    s: int  # -1, 0 or 1
    e: int


@jit
def no_root() -> Root:
    zero = np.zeros(1, np.int64)
    return Root(False, zero, zero, zero, 0, 0)


@jit
def ratio(p: Integer, q: Integer, e: int) -> Root:
    """2^e p / q, q not zero."""
    s = sign(q)
    return Root(True, signed(s, p), np.zeros(1, np.int64), signed(s, q), 0, e)


@jit
def surd_of_float(x: float) -> Root:
    """A finite float64."""
    e = lowest_exponent((x,))
    return ratio(integer(x, e), np.ones(1, np.int64), e)


@jit
def sign_of_surd(a: Integer, b: Integer, r: Integer) -> int:
    """The sign of a + b sqrt(r)."""
    first, second = sign(a), sign(b) * sign(r)
    if first == 0 or second == 0 or first == second:
        return first if first != 0 else second
    return first * sign(minus(times(a, a), times(times(b, b), r)))


@jit
def compare(x: Root, y: Root) -> int:
    """The sign of x - y, both hits."""
    e = min(x.e, y.e)
    qx, qy = shifted(x.q, y.e - e), shifted(y.q, x.e - e)
    a = minus(times(x.p, qy), times(y.p, qx))
    b, c = signed(x.s, qy), signed(-y.s, qx)
    if x.s == 0:
        return sign_of_surd(a, c, y.r)
    if y.s == 0:
        return sign_of_surd(a, b, x.r)
    bbr, ccr = times(times(b, b), x.r), times(times(c, c), y.r)
    roots = sign(b) if sign(b) == sign(c) else sign(b) * sign(minus(bbr, ccr))  # of b sqrt(x.r) + c sqrt(y.r)
    first = sign(a)
    if first == 0 or roots == 0 or first == roots:
        return first if first != 0 else roots
    rest = minus(
        minus(times(a, a), bbr), ccr
    )  # a^2 - (b sqrt(x.r) + c sqrt(y.r))^2, but for 2 b c sqrt(x.r y.r)
    product = times(b, c)
    return first * sign_of_surd(rest, signed(-1, plus(product, product)), times(x.r, y.r))


@jit
def is_within(x: Root, t_min: float, t_max: float) -> bool:
    """Whether t_min < x <= t_max; t_max may be infinite."""
    if compare(x, surd_of_float(t_min)) <= 0:
        return False
    return t_max == math.inf or compare(x, surd_of_float(t_max)) <= 0


@jit
def times_power(f: float, e: int) -> float:
    """f 2^e; the largest float64, with f's sign, where that is larger still."""
    m, exponent = math.frexp(f)
    if m != 0.0 and exponent + e > 1024:
        return math.copysign(LARGEST_FLOAT, f)
    return math.ldexp(m, max(exponent + e, -2000))


@jit
def as_float(x: Root) -> float:
    """x as float64, within AS_FLOAT_REL_ERROR of itself (or of the largest float64)."""
    p, ep = leading(x.p)
    q, eq = leading(x.q)
    if x.s == 0:
        return times_power(p / q, ep - eq + x.e)
    r, er = leading(x.r)
    if er % 2 != 0:
        r, er = 2.0 * r, er - 1
    e = max(ep, er // 2)
    p, root = times_power(p, ep - e), x.s * times_power(math.sqrt(r), er // 2 - e)
    if sign(x.p) != -x.s:
        return times_power((p + root) / q, e - eq + x.e)
    # p and s sqrt(r) nearly cancel: (p + s sqrt(r)) (p - s sqrt(r)) = p^2 - r, which is exact
    product, ec = leading(minus(times(x.p, x.p), x.r))
    return times_power(product / (q * (p - root)), ec - eq - e + x.e)

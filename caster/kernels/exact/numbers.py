"""Exact arithmetic where float64 cannot decide: big integers, and ray parameters t built from them.

An integer is an array of int64 digits to the base 2^26, lowest first: all but the last in [0, 2^26), the last, which
carries the sign, in [-2^26, 2^26]. Nothing is rounded, and no digit overflows: see ROWS_PER_CARRY.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from caster.jit.decorators import jit

# ---- integers ----

BITS = 26
BASE = 1 << BITS
MASK = BASE - 1
MANTISSA = 53

# A product of two digits is at most 2^52, so 2^10 of them, and a carry, stay below 2^63.
ROWS_PER_CARRY = 1 << 10

Integer = Any  # (digits,) int64
Integer3 = tuple[Integer, Integer, Integer]


@jit
def propagate_carries(x: Integer) -> None:
    """Bring all digits but the last into [0, BASE)."""
    carry = 0
    for i in range(len(x) - 1):
        total = x[i] + carry
        carry = total >> BITS
        x[i] = total & MASK
    x[len(x) - 1] += carry


@jit
def trimmed(x: Integer) -> Integer:
    """x with all digits in range and none superfluous."""
    propagate_carries(x)
    n = len(x)
    while n > 1 and (x[n - 1] == 0 or x[n - 1] == -1):
        if x[n - 1] == -1:
            x[n - 2] -= BASE
        n -= 1
    return x[:n]


@jit
def lowest_exponent(v: Any) -> int:
    """The largest e for which all float64 of a tuple are sure to be whole multiples of 2^e; 0 if all are zero."""
    lowest = 1 << 20
    for x in v:
        if x != 0.0:
            lowest = min(lowest, math.frexp(x)[1] - MANTISSA)
    return 0 if lowest == 1 << 20 else lowest


@jit
def integer(x: float, e: int) -> Integer:
    """x / 2^e, for an e that lowest_exponent gave."""
    if x == 0.0:
        return np.zeros(1, np.int64)
    m, exponent = math.frexp(x)
    whole = int(math.ldexp(m, MANTISSA))
    shift = exponent - MANTISSA - e
    at, left = shift // BITS, shift % BITS
    out = np.zeros(at + 4, np.int64)
    out[at] = (whole & MASK) << left
    out[at + 1] = ((whole >> BITS) & MASK) << left
    out[at + 2] = (whole >> (2 * BITS)) << left
    return trimmed(out)


@jit
def integers(v: Any, e: int) -> Integer3:
    """A vector over 2^e."""
    return integer(v[0], e), integer(v[1], e), integer(v[2], e)


@jit
def sign(x: Integer) -> int:
    last = x[len(x) - 1]
    return 1 if last > 0 else (-1 if last < 0 else 0)


PRODUCT = 0


@jit
def sum_or_product(a: Integer, b: Integer, how: int) -> Integer:
    """a b for how = PRODUCT, else a + how b, how = 1 or -1.

    One function for all three, large enough that LLVM does not inline it: exact decisions have hundreds of calls, and
    would take a minute to compile inlined.
    """
    if how == PRODUCT:
        out = np.zeros(len(a) + len(b), np.int64)
        for i in range(len(a)):
            digit = a[i]
            if digit != 0:
                for j in range(len(b)):
                    out[i + j] += digit * b[j]
            if (i + 1) % ROWS_PER_CARRY == 0:
                propagate_carries(out)
    else:
        out = np.zeros(max(len(a), len(b)) + 1, np.int64)
        for i in range(len(a)):
            out[i] = a[i]
        for i in range(len(b)):
            out[i] += how * b[i]
    return trimmed(out)


@jit
def plus(a: Integer, b: Integer) -> Integer:
    return sum_or_product(a, b, 1)


@jit
def minus(a: Integer, b: Integer) -> Integer:
    return sum_or_product(a, b, -1)


@jit
def times(a: Integer, b: Integer) -> Integer:
    return sum_or_product(a, b, PRODUCT)


@jit
def signed(s: int, a: Integer) -> Integer:
    """s a, for s = -1, 0 or 1."""
    if s > 0:
        return a
    zero = np.zeros(1, np.int64)
    return sum_or_product(zero, a, -1) if s < 0 else zero


@jit
def shifted(a: Integer, bits: int) -> Integer:
    """a 2^bits, bits >= 0."""
    if bits == 0:
        return a
    at, left = bits // BITS, bits % BITS
    out = np.zeros(at + len(a) + 1, np.int64)
    for i in range(len(a)):
        out[at + i] = a[i] << left
    return trimmed(out)


@jit
def minus3(a: Integer3, b: Integer3) -> Integer3:
    return minus(a[0], b[0]), minus(a[1], b[1]), minus(a[2], b[2])


@jit
def dot_integer(a: Integer3, b: Integer3) -> Integer:
    """The dot product."""
    return plus(plus(times(a[0], b[0]), times(a[1], b[1])), times(a[2], b[2]))


@jit
def cross_integer(a: Integer3, b: Integer3) -> Integer3:
    """The cross product."""
    x = minus(times(a[1], b[2]), times(a[2], b[1]))
    y = minus(times(a[2], b[0]), times(a[0], b[2]))
    z = minus(times(a[0], b[1]), times(a[1], b[0]))
    return x, y, z


@jit
def leading(a: Integer) -> tuple[float, int]:
    """(f, e) with a = f 2^e up to 2 u of itself: the four highest digits, added up with at most two roundings."""
    n = len(a)
    f, used = float(a[n - 1]), 1
    while used < min(n, 4):
        used += 1
        f = f * BASE + a[n - used]
    return f, BITS * (n - used)


# ---- parameters along a ray: t = 2^e (p + s sqrt(r)) / q in integers, and their order ----

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
    rest = minus(minus(times(a, a), bbr), ccr)  # a^2 - (b sqrt(x.r) + c sqrt(y.r))^2, but for 2 b c sqrt(x.r y.r)
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

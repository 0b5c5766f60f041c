"""Simpler numbers: fewer bits, nearer to 0."""

import math
from collections.abc import Iterator

BITS = (1, 2, 3, 4, 6, 8, 12, 24)  # of a mantissa, tried in this order


def cost(x: float) -> tuple[int, float]:
    """How complicated a number is: the bits of its mantissa, then how far it is from 1."""
    if x == 0.0:
        return (0, math.copysign(0.5, -x) + 0.5)  # 0.0 before -0.0
    mantissa, exponent = math.frexp(abs(x))
    bits = int(mantissa * 2.0**53)
    significant = 53 - (bits & -bits).bit_length() + 1
    return (significant, abs(exponent - 1) + (0.5 if x < 0.0 else 0.0))


def simpler(x: float) -> Iterator[float]:
    """Numbers that might do instead of x, the simplest first, each simpler than x; none for an infinite one."""
    if not math.isfinite(x):
        return
    tried = {x}
    for candidate in _candidates(x):
        if math.isfinite(candidate) and candidate not in tried and cost(candidate) < cost(x):
            tried.add(candidate)
            yield candidate
    if x == 0.0 and math.copysign(1.0, x) < 0.0:
        yield 0.0


def _candidates(x: float) -> Iterator[float]:
    yield from (0.0, 1.0, -1.0)
    if x == 0.0:
        return
    yield abs(x)
    mantissa, exponent = math.frexp(x)
    for bits in BITS:
        rounded = round(math.ldexp(mantissa, bits))
        if exponent - bits < 1000:
            yield math.ldexp(rounded, exponent - bits)
    yield math.ldexp(mantissa, 1)

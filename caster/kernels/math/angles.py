"""Sines, cosines and angles by sums, products and quotients of float64, without a branch or a call.

Their bits are the same on every machine, compiled or not, and loops over pixels can compute several at once. The C
library and NumPy choose code by the processor (with or without FMA or AVX-512), and the last bits differ.
"""

import math
from typing import Any

from caster.jit.decorators import inlined

# The Taylor series of sin(h) / h and cos(h) in h^2. At h = pi / 2 the first terms left out are
# (pi / 2)^24 / 25! = 3e-21 and (pi / 2)^24 / 24! = 8e-20: nothing beside a rounding, 1e-16.
SERIES_TERMS = 12
SINE = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(SERIES_TERMS))
COSINE = tuple((-1.0) ** k / math.factorial(2 * k) for k in range(SERIES_TERMS))


@inlined
def sinc_and_cos(square: float) -> tuple[float, float]:
    """(sin(h) / h, cos(h)) for square = h^2 and h at most a quarter turn, each within 2^-51."""
    sine, cosine = SINE[SERIES_TERMS - 1], COSINE[SERIES_TERMS - 1]
    for k in range(SERIES_TERMS - 2, -1, -1):
        sine, cosine = sine * square + SINE[k], cosine * square + COSINE[k]
    return sine, cosine


# The Taylor series of (atan(t) / t - 1) / t^2 in t^2. At t = tan(pi / 8), t^2 = 0.172, the first term left out is
# 0.172^21 / 45 = 2e-18 of t.
ARCTANGENT = tuple((-1.0) ** k / (2 * k + 1) for k in range(1, 22))
TAN_OF_SIXTEENTH_TURN = 0.4142135623730951


@inlined
def eighths_and_rest(y: Any, x: Any) -> Any:
    """(k, r) with atan2(|y|, x) = k pi / 4 + r and |r| <= pi / 8, r within 2^-51 of itself; (0, 0) for x = y = 0.

    y, x: finite, not denormal unless 0, |x| + |y| finite; numbers, or arrays in plain Python (`.function`).
    """
    aside, ahead = abs(y), abs(x)
    steep, behind = 1.0 * (aside > ahead), 1.0 * (x < 0.0)
    level = 1.0 - steep
    low, high = steep * ahead + level * aside, steep * aside + level * ahead
    wide = 1.0 * (low > TAN_OF_SIXTEENTH_TURN * high)
    t = (low - wide * high) / (high + wide * low + 1.0 * (high == 0.0))
    square, series = t * t, ARCTANGENT[-1]
    for k in range(len(ARCTANGENT) - 2, -1, -1):
        series = series * square + ARCTANGENT[k]
    turned = 1.0 - 2.0 * steep
    eighths = 2.0 * steep + turned * wide
    sense = 1.0 - 2.0 * behind
    return 4.0 * behind + sense * eighths, sense * turned * (t + t * (square * series))


@inlined
def arctangent(y: float, x: float) -> float:
    """atan2(y, x) in radians, within 2^-50 of itself; 0 for x = y = 0, and never -pi."""
    eighths, rest = eighths_and_rest(y, x)
    return (1.0 - 2.0 * (y < 0.0)) * (0.25 * math.pi * eighths + rest)


@inlined
def arcsine(x: float) -> float:
    """asin(x) in radians, for x in [-1, 1]."""
    return arctangent(x, math.sqrt((1.0 - x) * (1.0 + x)))


@inlined
def sine_and_cosine_of(angle: float) -> tuple[float, float]:
    """(sin, cos) of an angle of at most half a turn either way, each within 2^-49."""
    half = 0.5 * angle
    sinc, cosine = sinc_and_cos(half * half)
    sine = half * sinc
    return 2.0 * sine * cosine, 1.0 - 2.0 * sine * sine


TURNS_PER_RADIAN = 0.5 / math.pi
LAST_BELOW_ONE = 1.0 - 2.0**-53


@inlined
def turn_fraction(y: float, x: float) -> float:
    """atan2(y, x) as a fraction of a turn in [0, 1)."""
    eighths, rest = eighths_and_rest(y, x)
    whole, sense = (1.0, -1.0) if y < 0.0 else (0.0, 1.0)
    return min((whole + sense * 0.125 * eighths) + sense * TURNS_PER_RADIAN * rest, LAST_BELOW_ONE)


@inlined
def polar_fraction(z: float) -> float:
    """acos(z) as a fraction of half a turn in [0, 1], for z in [-1, 1]."""
    eighths, rest = eighths_and_rest(math.sqrt((1.0 - z) * (1.0 + z)), z)
    return 0.25 * eighths + 2.0 * TURNS_PER_RADIAN * rest

"""Sines, cosines, tangents and powers, rounded once from integers: the same bits on every machine.

The functions of the C library are good to a unit in the last place, and that unit depends on the library and on the
processor: glibc has code of its own for those with FMA.
"""

from decimal import Context, Decimal

__all__ = ["power", "sine_and_cosine", "tangent"]

BITS = 128  # behind the point: of the sine of a number near pi, 2^-53, 75 bits are left
DIGITS = 40


def sine_and_cosine(angle: float) -> tuple[float, float]:
    """(sin, cos) of an angle in radians, finite and of a few turns at most."""
    sine, cosine, denominator = _sine_and_cosine(angle)
    return sine / denominator, cosine / denominator


def tangent(angle: float) -> float:
    """tan of an angle in radians, below a quarter turn."""
    sine, cosine, _ = _sine_and_cosine(angle)
    return sine / cosine


def _sine_and_cosine(angle: float) -> tuple[int, int, int]:
    """(sin, cos, 1) of an angle, times a whole number. By the Taylor series of sin(h) / h and cos(h) in h^2."""
    numerator, denominator = angle.as_integer_ratio()
    square = (numerator * numerator << BITS) // (denominator * denominator)
    sinc = cosine = sinc_term = cosine_term = 1 << BITS
    k = 1
    while sinc_term or cosine_term:
        cosine_term = -(cosine_term * square >> BITS) // (k * (k + 1))
        sinc_term = -(sinc_term * square >> BITS) // ((k + 1) * (k + 2))
        sinc, cosine = sinc + sinc_term, cosine + cosine_term
        k += 2
    return numerator * sinc, denominator * cosine, denominator << BITS


def power(base: float, exponent: float) -> float:
    """base to the power of exponent, for base > 0."""
    return float(Context(prec=DIGITS).power(Decimal(base), Decimal(exponent)))

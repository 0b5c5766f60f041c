"""Sums and products of float64 without an error: a rounded number and what it lacks (Dekker 1971, Knuth 1969)."""

import math

from caster.jit.decorators import jit
from caster.kernels.protocol import Vec3

SPLITTER = 2.0**27 + 1.0

DoubleDouble = tuple[float, float]
"""A number and its error: their exact sum is meant."""


@jit
def two_diff(a: float, b: float) -> DoubleDouble:
    """a - b."""
    s = a - b
    part = s - a
    return s, (a - (s - part)) - (b + part)


@jit
def split(a: float) -> DoubleDouble:
    """a in two numbers of 26 bits, for |a| < 2^996."""
    big = SPLITTER * a
    high = big - (big - a)
    return high, a - high


@jit
def two_product(a: float, b: float) -> DoubleDouble:
    """a b, where neither overflows nor loses bits to underflow."""
    p = a * b
    (a1, a2), (b1, b2) = split(a), split(b)
    return p, ((a1 * b1 - p) + a1 * b2 + a2 * b1) + a2 * b2


@jit
def scaled_edge(a: Vec3, b: Vec3) -> tuple[Vec3, Vec3]:
    """b - a and what that lacks, times a power of two: its largest component is in [1/2, 1), or it is zero."""
    (x, p), (y, q), (z, r) = two_diff(b[0], a[0]), two_diff(b[1], a[1]), two_diff(b[2], a[2])
    e = -math.frexp(max(abs(x), abs(y), abs(z)))[1]
    rounded = math.ldexp(x, e), math.ldexp(y, e), math.ldexp(z, e)
    return rounded, (math.ldexp(p, e), math.ldexp(q, e), math.ldexp(r, e))


@jit
def determinant(a: DoubleDouble, b: DoubleDouble, c: DoubleDouble, d: DoubleDouble) -> float:
    """a d - b c, off by some u^2 of |a d| + |b c| and, where that is less, by u of itself."""
    p, p_error = two_product(a[0], d[0])
    q, q_error = two_product(b[0], c[0])
    s, s_error = two_diff(p, q)
    mixed = (a[0] * d[1] - b[0] * c[1]) + (a[1] * d[0] - b[1] * c[0])
    return s + (s_error + (p_error - q_error) + mixed)


@jit
def cross_of_edges(a: Vec3, b: Vec3, c: Vec3) -> Vec3:
    """(b - a) x (c - a), times a power of two, of corners that may lie in a line but for their last bits."""
    (x1, y1, z1), (p1, q1, r1) = scaled_edge(a, b)
    (x2, y2, z2), (p2, q2, r2) = scaled_edge(a, c)
    return (
        determinant((y1, q1), (z1, r1), (y2, q2), (z2, r2)),
        determinant((z1, r1), (x1, p1), (z2, r2), (x2, p2)),
        determinant((x1, p1), (y1, q1), (x2, p2), (y2, q2)),
    )

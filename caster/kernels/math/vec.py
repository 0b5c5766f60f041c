"""Vectors as tuples of three floats, and error-free transformations of float64."""

import math
from typing import Any

from caster.jit.decorators import inlined, jit
from caster.kernels.protocol import Vec3

U = 2.0**-53  # unit round-off of float64

# Results of `intersect`: (t, error) with the exact t certainly in [t - error, t + error], or one of these.
MISS = math.inf, 0.0
UNDECIDED = 0.0, math.inf

# Products that underflow are off by up to 2^-1075 each, a few dozen of them in a test, some multiplied by d later:
# error bounds get this much on top (and times |d|), and numbers so small that it matters go to exact arithmetic.
TINY = 2.0**-1020


@jit
def row(a: Any, k: Any) -> Vec3:
    return a[k, 0], a[k, 1], a[k, 2]


@jit
def dot(a: Vec3, b: Vec3) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@jit
def l1_norm(a: Vec3) -> float:
    """Sum of magnitudes; at least the length."""
    return abs(a[0]) + abs(a[1]) + abs(a[2])


@jit
def all_products_zero(a: Vec3, b: Vec3) -> bool:
    """Whether a.b is exactly 0 because each of its products has a factor 0."""
    x, y, z = (a[0] == 0.0) | (b[0] == 0.0), (a[1] == 0.0) | (b[1] == 0.0), (a[2] == 0.0) | (b[2] == 0.0)
    return x & y & z


@jit
def add(a: Vec3, b: Vec3) -> Vec3:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@jit
def sub(a: Vec3, b: Vec3) -> Vec3:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@jit
def point_at(o: Vec3, t: float, d: Vec3) -> Vec3:
    return o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2]


@jit
def scaled(s: float, a: Vec3) -> Vec3:
    return s * a[0], s * a[1], s * a[2]


@jit
def component_max(a: Vec3, b: Vec3) -> Vec3:
    return max(a[0], b[0]), max(a[1], b[1]), max(a[2], b[2])


@jit
def cross(a: Vec3, b: Vec3) -> Vec3:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@jit
def permanent(a: Vec3, b: Vec3) -> Vec3:
    """The cross product with magnitudes and sums only: its error scales with this."""
    x = abs(a[1] * b[2]) + abs(a[2] * b[1])
    y = abs(a[2] * b[0]) + abs(a[0] * b[2])
    z = abs(a[0] * b[1]) + abs(a[1] * b[0])
    return x, y, z


# Between these no square has lost bits to underflow and no sum of squares overflows. A power of two, which is
# exact, brings all other vectors there: from below 2^-450, down to the smallest number, or from above 2^499.
SMALLEST_SQUARE, LARGEST_SQUARE = 2.0**-900, 2.0**1000
UP, DOWN = 2.0**600, 2.0**-600


@jit
def normalize(a: Vec3) -> Vec3:
    """a / |a|, or a itself where it is zero."""
    square = dot(a, a)
    if square < SMALLEST_SQUARE or square > LARGEST_SQUARE:
        a = scaled(UP if square < SMALLEST_SQUARE else DOWN, a)
        square = dot(a, a)
    if square == 0.0:
        return a
    length = math.sqrt(square)
    return a[0] / length, a[1] / length, a[2] / length


@inlined
def fast_normalize(a: Vec3) -> tuple[bool, Vec3]:
    """(whether this is `normalize(a)`, a / |a|), without a branch; a itself where it is not."""
    square = dot(a, a)
    known = (square > SMALLEST_SQUARE) & (square < LARGEST_SQUARE)
    length = math.sqrt(square) if known else 1.0
    return known, (a[0] / length, a[1] / length, a[2] / length)


# The square of a camera's d is 1 within this: 10 u for an axis as it was given (transform.UNIT_ATOL), some 4 u for
# axes that are not quite across each other, and 12 u for six roundings of its length.
UNIT_SQUARE_ATOL = 32.0 * U


@jit
def unit_direction(a: Vec3) -> Vec3:
    """a normalized; a itself if its length is 1 but for a few u."""
    return a if abs(dot(a, a) - 1.0) <= UNIT_SQUARE_ATOL else normalize(a)


@inlined
def fast_unit_direction(a: Vec3) -> tuple[bool, Vec3]:
    """(whether this is `unit_direction(a)`, a), without a branch."""
    return abs(dot(a, a) - 1.0) <= UNIT_SQUARE_ATOL, a


@jit
def scaled_near_one(a: Vec3) -> Vec3:
    """a times a power of two, which is exact: its largest component is in [1/2, 1), or it is zero."""
    return times_power_of_two(a, -math.frexp(max_norm(a))[1])


@jit
def times_power_of_two(a: Vec3, e: int) -> Vec3:
    return math.ldexp(a[0], e), math.ldexp(a[1], e), math.ldexp(a[2], e)


@jit
def matrix_rows(m: Any, k: int) -> tuple[Vec3, Vec3, Vec3]:
    """The rows of the 3x3 matrix m[k]."""
    return (
        (m[k, 0, 0], m[k, 0, 1], m[k, 0, 2]),
        (m[k, 1, 0], m[k, 1, 1], m[k, 1, 2]),
        (m[k, 2, 0], m[k, 2, 1], m[k, 2, 2]),
    )


@jit
def rows_times_vec(m: tuple[Vec3, Vec3, Vec3], v: Vec3) -> Vec3:
    """The matrix with these rows times v; for loops over rays, where references to arrays would be counted."""
    return dot(m[0], v), dot(m[1], v), dot(m[2], v)


@jit
def hypotenuse(a: float, b: float) -> float:
    """sqrt(a^2 + b^2), if that is finite: the same bits on every machine, unlike hypot of the C library."""
    return math.sqrt(a * a + b * b)


@jit
def transposed_rows_times_vec(m: tuple[Vec3, Vec3, Vec3], v: Vec3) -> Vec3:
    """The transpose of the matrix with these rows times v."""
    return add(add(scaled(v[0], m[0]), scaled(v[1], m[1])), scaled(v[2], m[2]))


@jit
def mat_vec(m: Any, k: int, v: Vec3) -> Vec3:
    """The 3x3 matrix m[k] times v."""
    return rows_times_vec(matrix_rows(m, k), v)


@jit
def transposed_mat_vec(m: Any, k: int, v: Vec3) -> Vec3:
    """The transpose of m[k] times v: transforms a normal by the inverse of m."""
    return transposed_rows_times_vec(matrix_rows(m, k), v)


# A ray in object space: an entry of the inverse matrix is rounded once (inverse), a difference from the centre
# once, and a row's three products and two sums add 3 u more; the sixth is for terms in u^2.
TO_OBJECT_SPACE_ERROR = 6.0 * U


@jit
def to_object_space(m: tuple[Vec3, Vec3, Vec3], v: Vec3) -> tuple[Vec3, Vec3]:
    """(m v, how far off each component may be): for rows m of the rounded inverse of a matrix."""
    sums = abs_dot(m[0], v), abs_dot(m[1], v), abs_dot(m[2], v)
    return rows_times_vec(m, v), scaled(TO_OBJECT_SPACE_ERROR, sums)


@jit
def abs_dot(a: Vec3, b: Vec3) -> float:
    """The dot product of magnitudes."""
    return abs(a[0] * b[0]) + abs(a[1] * b[1]) + abs(a[2] * b[2])


@jit
def row_max_norms(m: tuple[Vec3, Vec3, Vec3]) -> Vec3:
    """The largest magnitude in each row: times l1_norm(v), at least the error of `to_object_space`."""
    return max_norm(m[0]), max_norm(m[1]), max_norm(m[2])


@jit
def max_norm(a: Vec3) -> float:
    return max(abs(a[0]), abs(a[1]), abs(a[2]))


# The following functions have no branch, so that loops over rays can test several at once (SIMD).


@inlined
def select(first: bool, a: Vec3, b: Vec3) -> Vec3:
    """a if `first`, else b."""
    return a[0] if first else b[0], a[1] if first else b[1], a[2] if first else b[2]


@inlined
def filter_result(hit: bool, missed: bool, t: float, error: float) -> tuple[float, float]:
    """(t, error) for a certain hit, MISS for a certain miss, else UNDECIDED."""
    return t if hit else (math.inf if missed else 0.0), error if hit else (0.0 if missed else math.inf)


@inlined
def certain_in_range(t: float, error: float, t_min: float, t_max: float) -> tuple[float, float]:
    """The result for a hit at t, within error, if t_min < t <= t_max. TINY: t and error may have underflowed."""
    error = error + TINY
    inside = (t - error > t_min) & (t + error <= t_max)
    return filter_result(inside, (t + error <= t_min) | (t - error > t_max), t, error)


# Error-free sums and products of float64: a rounded number and its error (Dekker 1971, Knuth 1969).


SPLITTER = 2.0**27 + 1.0

DoubleDouble = tuple[float, float]
"""The exact sum of a number and its error."""


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
    """b - a and its error, times a power of two: the largest component of b - a is in [1/2, 1), or it is zero."""
    (x, p), (y, q), (z, r) = two_diff(b[0], a[0]), two_diff(b[1], a[1]), two_diff(b[2], a[2])
    e = -math.frexp(max_norm((x, y, z)))[1]
    return times_power_of_two((x, y, z), e), times_power_of_two((p, q, r), e)


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


@jit
def cube_corner(j: int) -> tuple[float, float, float]:
    """Corner j of [-1, 1]^3, by the three lowest bits."""
    return 1.0 - 2.0 * (j & 1), 1.0 - (j & 2), 1.0 - 0.5 * (j & 4)

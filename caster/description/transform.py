"""Affine transforms as 4x4 float64 matrices acting on column vectors, p' = M p.

Sums of products have a fixed order and inverses are exact: NumPy's own (`@`, `np.linalg`) call a BLAS, whose last bits
depend on the processor. Sines, cosines, tangents and powers are computed with integers and rounded once: the last bit
of the C library's depends on the library and on the processor.
"""

import math
from collections.abc import Iterable, Sequence
from decimal import Context, Decimal
from fractions import Fraction
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "cross",
    "dot_rows",
    "inverse",
    "is_mirrored",
    "product",
    "rotations",
    "row_lengths",
    "sine_and_cosine",
    "unit",
]

Floats = NDArray[np.float64]
Matrix = Floats
Vector = tuple[float, float, float]
Frame = tuple[Vector, Vector, Vector]  # right, up, forward
Real = TypeVar("Real", float, Fraction)

# The computed cross product of two unit vectors is off by at most 2 u per component from its products and
# difference, and each unit vector by 2 u more: 8 u in all, u = 2^-53. The direction of anything shorter is unknown.
SHORTEST_CROSS = 8 * 2.0**-53

# Solving with a matrix of condition number k loses a factor k of the 2^-53 each number is good for: from 2^52
# on, no bit of the inverse is known to be right.
LARGEST_CONDITION = 2.0**52


def translate(v: Sequence[float]) -> Matrix:
    """Translation by v, in scene units."""
    matrix = np.eye(4)
    matrix[:3, 3] = v
    return matrix


def scale(s: float | Sequence[float]) -> Matrix:
    """Scaling by s about the origin, or by s[0], s[1], s[2] along x, y, z; negative factors mirror."""
    matrix = np.eye(4)
    matrix[[0, 1, 2], [0, 1, 2]] = s
    return matrix


def rotate(axis: Sequence[float], degrees: float) -> Matrix:
    """Rotation about an axis through the origin, counter-clockwise seen from its tip. Quarter turns are exact.

    axis: any length but 0. Raises ValueError for an axis without a direction.
    Source: Rodrigues' rotation formula.
    """
    x, y, z = unit(axis)
    turn = math.remainder(degrees, 360.0)  # exact, like the next two lines
    quarters = round(turn / 90.0)
    s, c = sine_and_cosine(math.radians(turn - 90.0 * quarters))
    c, s = ((c, s), (-s, c), (-c, -s), (s, -c))[quarters % 4]
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])  # maps a vector to its product with the axis
    matrix = np.eye(4)
    matrix[:3, :3] = np.outer((x, y, z), (x, y, z)) * (1.0 - c) + c * np.eye(3) + s * across
    return matrix


def rotations(quaternions: Floats) -> Floats:
    """(n, 3, 3) rotation matrices of quaternions (n, 4) x, y, z, w of any length but 0. Source: Shoemake 1985."""
    x, y, z, w = np.transpose(quaternions / np.abs(quaternions).max(axis=1)[:, None])
    norm = x * x + y * y + z * z + w * w
    rows = [
        [y * y + z * z, w * z - x * y, -w * y - x * z],
        [-w * z - x * y, x * x + z * z, w * x - y * z],
        [w * y - x * z, -w * x - y * z, x * x + y * y],
    ]
    return np.eye(3) - np.moveaxis(2.0 / norm * np.array(rows), 2, 0)


def look_at(origin: Sequence[float], target: Sequence[float], up: Sequence[float]) -> Matrix:
    """Rigid transform that maps the origin to `origin`, +z towards `target`, and +y as close to `up` as possible.

    Raises ValueError if origin equals target, or up is parallel to the view.
    """
    right, new_up, forward = frame(unit(subtract(target, origin)), up)
    matrix = np.eye(4)
    matrix[:3, 0] = [-r for r in right]  # x = y cross z points to the left of the view
    matrix[:3, 1] = new_up
    matrix[:3, 2] = forward
    matrix[:3, 3] = origin
    return matrix


def compose(steps: Iterable[ArrayLike]) -> Matrix:
    """Composition of matrices, applied in the order given. Identical bits on every machine."""
    total = np.eye(4)
    with np.errstate(over="ignore", invalid="ignore"):  # callers check the result
        for step in steps:
            total = product(np.asarray(step, np.float64), total) + 0.0  # which leaves no negative zeros
    return total


def product(a: Matrix, b: Matrix) -> Matrix:
    """The product of two matrices, or of rows (n, k) and a matrix (k, m), summed from the first column of a on."""
    total: Matrix = a[:, 0, None] * b[None, 0, :]
    for k in range(1, len(b)):
        total = total + a[:, k, None] * b[None, k, :]
    return total


def transform_points(matrix: Matrix, points: Floats) -> Floats:
    """Points (n, 3) under an affine matrix (4, 4): ((m0 x + m1 y) + m2 z) + m3 for each coordinate."""
    moved = transform_vectors(matrix[:3, :3], points)
    moved += matrix[:3, 3]
    return moved


def transform_vectors(linear: Matrix, vectors: Floats) -> Floats:
    """Vectors (n, 3) under a matrix (3, 3): (m0 x + m1 y) + m2 z for each coordinate."""
    return product(vectors, linear.T)


def dot_rows(vectors: Floats, v: Any) -> Floats:
    """(n,): the dot products of vectors (n, 3) with v, (3,) or (n, 3), summed in the order of x, y, z."""
    x, y, z = (vectors * v).T
    return np.asarray(x + y + z)


def row_lengths(vectors: Floats) -> Floats:
    """(n,): the lengths of vectors (n, 3) whose squares neither overflow nor underflow."""
    return np.sqrt(dot_rows(vectors, vectors))


def is_invertible(matrix: Matrix) -> bool:
    """Whether a finite affine matrix is invertible in float64. Small and large uniform scales are."""
    linear = matrix[:3, :3]
    try:
        both = linear.tolist(), inverse(linear).tolist()
    except np.linalg.LinAlgError:
        return False
    # the largest sum of magnitudes of a row: the norm that belongs to the largest component of vectors
    norm, norm_of_inverse = (max(abs(x) + abs(y) + abs(z) for x, y, z in rows) for rows in both)
    return bool(norm * norm_of_inverse < LARGEST_CONDITION)


def inverse(m: Matrix) -> Matrix:
    """The inverse of a 3x3 matrix, every entry rounded once. Raises LinAlgError if it does not exist in float64."""
    if not np.isfinite(m).all():
        raise np.linalg.LinAlgError("not finite")
    cofactors, determinant, denominator = _integer_inverse(m)
    if determinant == 0:
        raise np.linalg.LinAlgError("singular")
    try:
        rounded = np.array([[denominator * x / determinant for x in row] for row in cofactors])
    except OverflowError:
        raise np.linalg.LinAlgError("too small to be inverted in float64") from None
    if np.any((rounded == 0.0) & (np.array(cofactors, object) != 0)):
        raise np.linalg.LinAlgError("too large to be inverted in float64")
    return rounded


def is_mirrored(matrix: Matrix) -> bool:
    """Whether a finite affine matrix mirrors: its determinant is negative, exactly."""
    _, determinant, _ = _integer_inverse(matrix[:3, :3])
    return determinant < 0


def _integer_inverse(m: Matrix) -> tuple[list[list[int]], int, int]:
    """(cofactors, transposed; determinant; scale) of the entries, scaled to integers by a power of two.

    The cofactors times the integers are the determinant times the identity.
    """
    ratios = [[x.as_integer_ratio() for x in row] for row in m.tolist()]
    scale = max(q for row in ratios for _, q in row)
    rows = [[p * (scale // q) for p, q in row] for row in ratios]
    cofactors = [
        [rows[j - 2][i - 2] * rows[j - 1][i - 1] - rows[j - 2][i - 1] * rows[j - 1][i - 2] for j in range(3)]
        for i in range(3)
    ]
    return cofactors, sum(rows[0][j] * cofactors[j][0] for j in range(3)), scale


def frame(forward: Vector, up: Sequence[float]) -> Frame:
    """(right, up, forward), orthonormal: right = forward x up, up = right x forward. forward: of unit length.

    Raises ValueError if up is zero, not finite or parallel to forward.
    """
    side = cross(forward, unit(up))
    if math.hypot(*side) <= SHORTEST_CROSS:
        raise ValueError("up lies along the view")
    new_up = unit(cross(unit(side), forward))
    return unit(cross(forward, new_up)), new_up, forward  # side itself is inexact where up is nearly along


def cross(a: Sequence[Real], b: Sequence[Real]) -> tuple[Real, Real, Real]:
    """Cross product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def subtract(a: Sequence[Real], b: Sequence[Real]) -> tuple[Real, Real, Real]:
    """Difference a - b; zero only if a equals b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


# The length of a normalised vector, computed again, is 1 within 2 u of the length it was divided by (hypot is
# good to a unit in the last place), u of the quotients and 2 u of the new length, u = 2^-53. Such a vector is
# kept to the bit, so that normalising twice changes nothing.
UNIT_ATOL = 5 * 2.0**-53


def unit(v: Sequence[float]) -> Vector:
    """v normalized; unchanged if its length is 1 already. Raises ValueError if v is zero or not finite."""
    largest = max(abs(x) for x in v)
    if not 0.0 < largest < math.inf:
        raise ValueError("a vector without a direction")
    if abs(math.hypot(*v) - 1.0) <= UNIT_ATOL:
        return float(v[0]), float(v[1]), float(v[2])
    exponent = -math.frexp(largest)[1]  # a power of two scales exactly, and keeps tiny quotients accurate
    x, y, z = (math.ldexp(c, exponent) for c in v)
    length = math.hypot(x, y, z)
    return x / length, y / length, z / length


# Sines, cosines, tangents and powers.

BITS = 128  # after the binary point: the sine of a number near pi is about 2^-53, which leaves 75 significant bits
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

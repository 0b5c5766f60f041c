"""Slow and obvious: what one ray meets of one primitive, in decimals of 80 digits.

Nothing here is taken from the kernels: the inputs are float64 numbers, turned into decimals without rounding,
and every formula is the textbook one. Each answer comes with two numbers that say how far off float64 may be:

- `condition`: how many times u the relative error of t is where the ray and the primitive are rounded by u;
- `margin`: how far the ray is from where hit and miss meet, relative to the numbers it is computed from.
"""

from collections.abc import Callable
from decimal import Decimal, localcontext
from typing import Any, NamedTuple

import numpy as np
from decimals import DIGITS, determinant, dot, exactly, inverse, norm, size

NOT_CLOSE = Decimal(1)


class Answer(NamedTuple):
    """t is None for a miss."""

    t: Decimal | None
    condition: float
    margin: float


def triangle(prims: Any, k: int, o: Any, d: Any) -> Answer:
    """o + t d = a + b1 (b - a) + b2 (c - a), solved by Cramer's rule."""
    a, b, c = exactly(prims.vertices[prims.faces[k]])
    e1, e2, f = b - a, c - a, o - a
    across, reach = -determinant(d, e1, e2), size(f, b - o, c - o)
    margin = float(to_nearest_edge(a - o, b - o, c - o, d) / reach)
    if across == 0:
        return Answer(None, 1.0, margin)
    b1, b2 = -determinant(d, f, e2) / across, -determinant(d, e1, f) / across
    t = determinant(f, e1, e2) / across
    if min(b1, b2, 1 - b1 - b2, t) < 0 or t == 0:
        return Answer(None, 1.0, margin)
    # A corner that moves by u reach moves an edge by as much; the hit moves along the ray by that times the
    # triangle's stretch in the ray's eyes, its longest side squared over its area there.
    stretch = size(e1, e2, c - b) ** 2 * norm(d) / abs(across)
    return Answer(t, float(stretch * reach / (t * norm(d))), margin)


def to_nearest_edge(a: Any, b: Any, c: Any, d: Any) -> Decimal:
    """How closely the line through 0 along d passes one of the edges between three points."""
    flat = [p - d * (dot(p, d) / dot(d, d)) for p in (a, b, c)]
    squares = []
    for p, q in ((flat[0], flat[1]), (flat[1], flat[2]), (flat[2], flat[0])):
        along = dot(q - p, q - p)
        share = min(max(-dot(p, q - p) / along, Decimal(0)), Decimal(1)) if along else Decimal(0)
        nearest = p + share * (q - p)
        squares.append(dot(nearest, nearest))
    return min(squares).sqrt()


def plane(prims: Any, k: int, o: Any, d: Any) -> Answer:
    n, f = exactly(prims.normal[k]), exactly(prims.point[k]) - o
    slope = dot(n, d)
    if slope == 0:
        return Answer(None, 1.0, 0.0)
    t = dot(n, f) / slope
    condition = norm(n) * norm(d) / abs(slope) + norm(n) * norm(f) / abs(slope * t)
    return Answer(t if t > 0 else None, float(condition), float(abs(dot(n, f)) / norm(n) / norm(f)))


def sphere(prims: Any, k: int, o: Any, d: Any) -> Answer:
    r = exactly(prims.radius[k])
    f = (o - exactly(prims.center[k])) / r
    return quadric(f, d / r, 1 + norm(f), lambda t: True)


class Placed(NamedTuple):
    """A ray as a shape's own coordinates have it, and the condition number of the matrix in between."""

    f: Any
    e: Any
    condition: Decimal


def placed(prims: Any, k: int, o: Any, d: Any) -> Placed:
    m = exactly(prims.to_world[k])
    undo = inverse(m)
    return Placed(undo @ (o - exactly(prims.center[k])), undo @ d, norm(m) * norm(undo))


def ellipsoid(prims: Any, k: int, o: Any, d: Any) -> Answer:
    f, e, condition = placed(prims, k, o, d)
    return quadric(f, e, condition * (1 + norm(f)), lambda t: True)


def cylinder(prims: Any, k: int, o: Any, d: Any) -> Answer:
    f, e, condition = placed(prims, k, o, d)
    flat = np.array([Decimal(1), Decimal(1), Decimal(0)])
    reach = condition * (1 + norm(f)) * norm(e) / norm(e * flat)  # along the axis, the wall is met at a slant
    answer = quadric(f * flat, e * flat, reach, lambda t: 0 <= f[2] + t * e[2] <= 1)
    to_ends = [abs(f[2] + t * e[2] - end) for t in roots(f * flat, e * flat) for end in (0, 1)]
    return answer._replace(margin=min(answer.margin, float(min(to_ends, default=NOT_CLOSE) / reach)))


def disk(prims: Any, k: int, o: Any, d: Any) -> Answer:
    f, e, condition = placed(prims, k, o, d)
    if e[2] == 0:
        return Answer(None, 1.0, 0.0)
    t = -f[2] / e[2]
    p = f + t * e
    loss = condition * (norm(f) + norm(t * e)) / abs(e[2]) * norm(e)  # of a displacement, along the ray
    beyond = p[0] * p[0] + p[1] * p[1] - 1
    hit = t > 0 and beyond <= 0
    condition_of_t = float(loss / (abs(t) * norm(e))) if t else 1.0
    return Answer(t if hit else None, condition_of_t, float(min(abs(beyond) / (loss + 1), abs(f[2]) / norm(f))))


def roots(f: Any, e: Any) -> list[Decimal]:
    """Both t at which |f + t e| = 1, the smaller first; none for a ray that passes by."""
    a, b, c = dot(e, e), dot(f, e), dot(f, f) - 1
    inside = b * b - a * c
    return [(-b - inside.sqrt()) / a, (-b + inside.sqrt()) / a] if a and inside >= 0 else []


def quadric(f: Any, e: Any, reach: Decimal, counts: Callable[[Decimal], bool]) -> Answer:
    """The first root ahead that counts. Where the ray moves, an end of its chord moves 1 / h times as far.

    h: half the length of the chord; reach: what a rounding of u moves the ray by, in units of u and radii.
    """
    a, b, c = dot(e, e), dot(f, e), dot(f, f) - 1
    if a == 0:
        return Answer(None, 1.0, 0.0)
    inside = (b * b - a * c) / a  # squared half length of the chord, negative for a ray that passes by
    near_zero = min((abs(t) * a.sqrt() for t in roots(f, e)), default=NOT_CLOSE)
    margin = float(min(abs(inside), near_zero) / reach)
    ahead = [t for t in roots(f, e) if t > 0 and counts(t)]
    if not ahead:
        return Answer(None, 1.0, margin)
    h = max(inside.sqrt(), Decimal("1e-100"))
    condition_of_t = reach * (1 + 1 / h) / (ahead[0] * a.sqrt())
    return Answer(ahead[0], float(condition_of_t), margin)


# By the name of the packed arrays; each shape of the registry packs itself into one of these kinds.
EXACT: dict[str, Callable[[Any, int, Any, Any], Answer]] = {
    "Triangles": triangle,
    "Planes": plane,
    "Spheres": sphere,
    "Ellipsoids": ellipsoid,
    "Cylinders": cylinder,
    "Disks": disk,
}


def oracle(prims: Any) -> Callable[[Any, int, Any, Any], Answer]:
    """The slow evaluation of this kind of primitive."""
    kind = type(prims).__name__
    if kind not in EXACT:
        raise AssertionError(
            f"{kind}: no exact evaluation to compare `intersect` with: write a function of (prims, k, o, d) "
            "that gives the first t > 0 in decimals, and add it to EXACT in tests/agreement/exact.py"
        )
    return EXACT[kind]


def answers(prims: Any, o: Any, d: Any) -> list[Answer]:
    """For a ray of floats, what it meets of each primitive alone."""
    count = len(prims.faces) if hasattr(prims, "faces") else len(prims[0])
    with localcontext(DIGITS):
        exact_o, exact_d = exactly(o), exactly(d)
        return [oracle(prims)(prims, k, exact_o, exact_d) for k in range(count)]

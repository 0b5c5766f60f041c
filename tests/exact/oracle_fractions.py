"""What rays meet, a second time: textbook formulas in Fractions, roots compared by the sign of the polynomial.

Nothing is taken from the oracle, and no formula is shared with it: triangles by Cramer's rule, matrices by elimination,
and a root is placed by where the parabola is above 0, not by squaring.
"""

from collections.abc import Callable
from fractions import Fraction
from math import isqrt
from typing import Any, NamedTuple

from flint import arb, ctx, fmpq

F = Fraction
Vector = list[Fraction]
Met = list[tuple["Solution", str]]


def sgn(x: Any) -> int:
    return (x > 0) - (x < 0)


class Solution(NamedTuple):
    """A root of a t^2 + 2 b t + c, a > 0: the smaller (-1), the larger (1), or both at once (0)."""

    a: Fraction
    b: Fraction
    c: Fraction
    side: int

    def compare(self, x: Fraction) -> int:
        """The sign of the root - x."""
        middle = -self.b / self.a
        value = sgn((self.a * x + 2 * self.b) * x + self.c)
        if self.side == 0:
            return sgn(middle - x)
        if self.side * sgn(x - middle) <= 0:  # x lies on the other root's side
            return self.side
        return -self.side * value

    def ball(self, bits: int) -> arb:
        ctx.prec = bits
        a, b, c = (arb(fmpq(x.numerator, x.denominator)) for x in (self.a, self.b, self.c))
        return (-b + self.side * (b * b - a * c).sqrt()) / a if self.side else -b / a

    def rational(self) -> Fraction | None:
        square = (self.b * self.b - self.a * self.c) / (self.a * self.a)
        above, below = isqrt(abs(square.numerator)), isqrt(square.denominator)
        if F(above * above, below * below) != square and self.side:
            return None
        return -self.b / self.a + self.side * F(above, below)


def linear(above: Fraction, below: Fraction) -> Solution:
    """above / below, as the double root of (t - x)^2."""
    x = above / below
    return Solution(F(1), -x, x * x, 0)


def order(x: Solution, y: Solution) -> int:
    """The sign of x - y. An irrational root belongs to one quadratic alone; unequal balls part at some precision."""
    first, second = x.rational(), y.rational()
    if first is not None and second is not None:
        return sgn(first - second)
    if first is None and second is None and (x.b / x.a, x.c / x.a, x.side) == (y.b / y.a, y.c / y.a, y.side):
        return 0
    bits = 128
    while True:
        one, other = x.ball(bits), y.ball(bits)
        if one < other or one > other:
            return 1 if one > other else -1
        bits *= 2


def exactly(numbers: Any) -> Any:
    return [F(float(x)) for x in numbers] if len(getattr(numbers, "shape", (0,))) == 1 else [*map(exactly, numbers)]


def dot(a: Vector, b: Vector) -> Fraction:
    return sum((x * y for x, y in zip(a, b, strict=True)), F(0))


def sub(a: Vector, b: Vector) -> Vector:
    return [x - y for x, y in zip(a, b, strict=True)]


def det(a: Vector, b: Vector, c: Vector) -> Fraction:
    return a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0])


def solved(m: list[Vector], *right: Vector) -> list[Vector] | None:
    """m^-1 right by elimination; None for a singular matrix."""
    rows = [[*m[i], *(v[i] for v in right)] for i in range(3)]
    for i in range(3):
        pivot = next((j for j in range(i, 3) if rows[j][i]), None)
        if pivot is None:
            return None
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [x / rows[i][i] for x in rows[i]]
        for j in {0, 1, 2} - {i}:
            rows[j] = [x - rows[j][i] * y for x, y in zip(rows[j], rows[i], strict=True)]
    return [[rows[i][3 + k] for i in range(3)] for k in range(len(right))]


def triangle(prims: Any, k: int, o: Vector, d: Vector) -> Met:
    """o + t d = a + b1 (b - a) + b2 (c - a)."""
    a, b, c = exactly(prims.vertices[prims.faces[k]])
    if any(abs(x) >= F(1.844e18) for x in (*a, *b, *c)):
        return []
    e1, e2, f = sub(b, a), sub(c, a), sub(o, a)
    across = -det(d, e1, e2)
    if across == 0:
        return []
    b1, b2 = -det(d, f, e2) / across, -det(d, e1, f) / across
    weights = (b1, b2, 1 - b1 - b2)
    if min(weights) < 0:
        return []
    return [(linear(det(f, e1, e2), across), ("inside", "edge", "vertex")[weights.count(0)])]


def plane(prims: Any, k: int, o: Vector, d: Vector) -> Met:
    n, point = exactly(prims.normal[k]), exactly(prims.point[k])
    slope = dot(n, d)
    return [(linear(dot(n, sub(point, o)), slope), "inside")] if slope else []


def through_circle(o: Vector, d: Vector, r: Fraction) -> Met:
    """Both t where |o + t d| = r, in two dimensions or three."""
    a, b, c = dot(d, d), dot(o, d), dot(o, o) - r * r
    inside = b * b - a * c
    if a == 0 or inside < 0:
        return []
    where = "inside" if inside else "tangent"
    return [(Solution(a, b, c, side), where) for side in ((-1, 1) if inside else (0,))]


def sphere(prims: Any, k: int, o: Vector, d: Vector) -> Met:
    return through_circle(sub(o, exactly(prims.center[k])), d, F(float(prims.radius[k])))


def in_object_space(prims: Any, k: int, o: Vector, d: Vector) -> list[Vector] | None:
    return solved(exactly(prims.to_world[k]), sub(o, exactly(prims.center[k])), d)


def ellipsoid(prims: Any, k: int, o: Vector, d: Vector) -> Met:
    ray = in_object_space(prims, k, o, d)
    return through_circle(*ray, F(1)) if ray else []


def cylinder(prims: Any, k: int, o: Vector, d: Vector) -> Met:
    ray = in_object_space(prims, k, o, d)
    if ray is None:
        return []
    (x, y, z), (u, v, w) = ray
    found = []
    for root, where in through_circle([x, y], [u, v], F(1)):
        # z + t w against 0 and 1: where w > 0, t against -z / w and (1 - z) / w
        bottom, top = ((sgn(w) * root.compare((end - z) / w)) if w else sgn(z - end) for end in (0, 1))
        if bottom >= 0 >= top:
            found.append((root, "rim" if where == "inside" and 0 in (bottom, top) else where))
    return found


def disk(prims: Any, k: int, o: Vector, d: Vector) -> Met:
    ray = in_object_space(prims, k, o, d)
    if ray is None or not ray[1][2]:
        return []
    t = -ray[0][2] / ray[1][2]
    x, y = (ray[0][i] + t * ray[1][i] for i in (0, 1))
    beyond = x * x + y * y - 1
    return [(linear(t, F(1)), "inside" if beyond else "rim")] if beyond <= 0 else []


def segment(prims: Any, k: int, o: Vector, d: Vector) -> Met:
    """The hull of two spheres, from the apex of the cone; where it is a cylinder, from the start."""
    a, b = exactly(prims.start[k]), exactly(prims.end[k])
    r, q = exactly(prims.radius[k])
    p, grow = sub(b, a), q - r
    size, from_apex = dot(p, p) - grow * grow, sub(o, a)
    if grow:
        from_apex = [x + y * r / grow for x, y in zip(from_apex, p, strict=True)]
    slope, height = dot(d, p), dot(from_apex, p)
    level = dot(sub(o, a), p) + r * grow  # from 0 to `size` on the cone

    def side(root: Solution, end: Fraction) -> int:
        return sgn(slope) * root.compare((end - level) / slope) if slope else sgn(level - end)

    at_start, at_end = through_circle(sub(o, a), d, r)[:1], through_circle(sub(o, b), d, q)[:1]
    found = [hit for hit in at_start if side(hit[0], F(0)) < 0] + [hit for hit in at_end if side(hit[0], size) > 0]
    x, y = size * dot(d, d) - slope * slope, size * dot(from_apex, d) - slope * height
    z = size * dot(from_apex, from_apex) - height * height - (0 if grow else r * r * size)
    inside = y * y - x * z
    if size > 0 and (inside >= 0 if x else y < 0):
        sign = sgn(x)
        root = Solution(x * sign, y * sign, z * sign, -sign if inside else 0) if x else linear(-z, 2 * y)
        if side(root, F(0)) >= 0 >= side(root, size):
            found.append((root, "inside" if inside or not x else "tangent"))
    return found


WITNESSES: dict[str, Callable[[Any, int, Vector, Vector], Met]] = {
    "Triangles": triangle,
    "Planes": plane,
    "Spheres": sphere,
    "Ellipsoids": ellipsoid,
    "Cylinders": cylinder,
    "Disks": disk,
    "OuterEllipsoids": lambda *given: ellipsoid(*given)[:1],
    "RoundSegments": segment,
}


def roots(prims: Any, k: int, o: Any, d: Any) -> Met:
    """Everything primitive k meets along the line, ascending."""
    return WITNESSES[type(prims).__name__](prims, k, exactly(o), exactly(d))

"""What rays meet, a third time: real arithmetic in balls of python-flint, straight from the formulas.

A sign that a ball does not tell is Undecided; ball arithmetic can never tell that something is exactly 0.
"""

from collections.abc import Callable
from typing import Any

from flint import arb, arb_mat, ctx

BITS = 400


class Undecided(Exception):  # noqa: N818 - an answer
    """A ball that holds 0."""


def positive(x: arb) -> bool:
    if x > 0 or x < 0:
        return bool(x > 0)
    raise Undecided


def column(numbers: Any) -> arb_mat:
    return arb_mat([[arb(float(x))] for x in numbers])


def dot(a: arb_mat, b: arb_mat) -> arb:
    return (a.transpose() * b)[0, 0]


def det(*columns: arb_mat) -> arb:
    return arb_mat([[v[i, 0] for v in columns] for i in range(3)]).det()


def triangle(prims: Any, k: int, o: arb_mat, d: arb_mat) -> list[arb]:
    corners = prims.vertices[prims.faces[k]]
    if abs(corners).max() >= 1.844e18:
        return []
    a, b, c = (column(v) - o for v in corners)
    sides = [positive(det(d, *pair)) for pair in ((b, c), (c, a), (a, b))]
    return [det(a, b, c) / det(d, b - a, c - a)] if len(set(sides)) == 1 else []


def plane(prims: Any, k: int, o: arb_mat, d: arb_mat) -> list[arb]:
    n = column(prims.normal[k])
    positive(dot(n, d))
    return [dot(n, column(prims.point[k]) - o) / dot(n, d)]


def ball(o: arb_mat, d: arb_mat, r: arb) -> list[arb]:
    a, b = dot(d, d), dot(o, d)
    inside = b * b - a * (dot(o, o) - r * r)
    return [(-b - inside.sqrt()) / a, (-b + inside.sqrt()) / a] if positive(inside) else []


def sphere(prims: Any, k: int, o: arb_mat, d: arb_mat) -> list[arb]:
    return ball(o - column(prims.center[k]), d, arb(float(prims.radius[k])))


def seen(prims: Any, k: int, o: arb_mat, d: arb_mat) -> tuple[arb_mat, arb_mat]:
    m = arb_mat([[arb(float(x)) for x in row] for row in prims.to_world[k]])
    try:
        return m.solve(o - column(prims.center[k])), m.solve(d)
    except ZeroDivisionError as error:
        raise Undecided from error


def ellipsoid(prims: Any, k: int, o: arb_mat, d: arb_mat) -> list[arb]:
    return ball(*seen(prims, k, o, d), arb(1))


def cylinder(prims: Any, k: int, o: arb_mat, d: arb_mat) -> list[arb]:
    f, e = seen(prims, k, o, d)
    flat = [arb_mat([[v[0, 0]], [v[1, 0]]]) for v in (f, e)]
    heights = [(t, f[2, 0] + t * e[2, 0]) for t in ball(*flat, arb(1))]
    return [t for t, z in heights if positive(z) and positive(1 - z)]


def disk(prims: Any, k: int, o: arb_mat, d: arb_mat) -> list[arb]:
    f, e = seen(prims, k, o, d)
    positive(e[2, 0])
    t = -f[2, 0] / e[2, 0]
    x, y = f[0, 0] + t * e[0, 0], f[1, 0] + t * e[1, 0]
    return [t] if positive(1 - x * x - y * y) else []


BALLS: dict[str, Callable[[Any, int, arb_mat, arb_mat], list[arb]]] = {
    "Triangles": triangle,
    "Planes": plane,
    "Spheres": sphere,
    "Ellipsoids": ellipsoid,
    "Cylinders": cylinder,
    "Disks": disk,
}


def roots(prims: Any, k: int, o: Any, d: Any) -> list[arb]:
    """Every t of primitive k along the line, ascending. Raises Undecided."""
    ctx.prec = BITS
    return BALLS[type(prims).__name__](prims, k, column(o), column(d))

"""Shapes of whole numbers, turned: points of their surfaces, normals and tangents there are exact, in float32 too.

A rotation by an integer quaternion, times its norm n, is a matrix of integers. With the points of Pythagorean triples
and quadruples on unit circles and balls, everything below is a whole number of at most a few thousands, far from the
axes and from every lattice that the shapes themselves might suggest; then all is scaled by a power of two.
"""

from collections.abc import Callable, Iterator
from itertools import permutations, product
from typing import Any, NamedTuple

import numpy as np

from cases.shapes import mesh_of
from caster import Cube, Cylinder, Disk, Mesh, Plane, Rectangle, Sphere, Triangle
from caster.shapes.icosphere import Icosphere

Rng = np.random.Generator
UNIT = 2.0**-5  # what "1" is


class Whole(NamedTuple):
    """A shape, and m points of its surface in whole multiples of UNIT."""

    kind: str
    shape: Any
    p: np.ndarray  # (m, 3)
    n: np.ndarray  # (m, 3) outwards, of any length
    tangent: np.ndarray  # (m, 3) along the surface, of any length
    inside: np.ndarray  # (m,) bool: neither on an edge nor on a rim


def whole_turn(rng: Rng, size: int = 3) -> tuple[np.ndarray, int]:
    """(M, n): M / n is a rotation that leaves no axis in its place."""
    while True:
        a, b, c, d = rng.integers(-size, size + 1, 4).tolist()
        if 0 not in (b, c, d):
            break
    rows = [
        [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
        [2 * (b * c + a * d), a * a - b * b + c * c - d * d, 2 * (c * d - a * b)],
        [2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d],
    ]
    return np.array(rows, np.float64), a * a + b * b + c * c + d * d


def signed(v: Any) -> np.ndarray:
    """All vectors with these magnitudes, in any order and with any signs."""
    every = {
        tuple(s * x for s, x in zip(signs, order, strict=True))
        for order in permutations(v)
        for signs in product((1, -1), repeat=len(v))
    }
    return np.array(sorted(every), np.float64)


ON_BALL = np.concatenate([signed(v) for v in ((1, 4, 8), (4, 4, 7), (3, 6, 6), (9, 0, 0))])  # of radius 9
ON_CIRCLE = np.concatenate([signed(v) for v in ((3, 4), (5, 0))])  # of radius 5
IN_CIRCLE = np.array([[1.0, 2.0], [-3.0, 1.0], [0.0, 0.0], [2.0, -4.0]])


def whole(rng: Rng, *shape: int, size: int = 40) -> np.ndarray:
    return rng.integers(-size, size + 1, shape).astype(np.float64)


def matrix_steps(linear: np.ndarray, center: np.ndarray) -> list[dict[str, Any]]:
    rows = np.column_stack([linear, center]) * UNIT
    return [{"matrix": [*rows.tolist(), [0.0, 0.0, 0.0, 1.0]]}]


def finished(kind: str, shape: Any, rng: Rng, p: np.ndarray, n: np.ndarray, inside: Any = True) -> Whole:
    """With tangents: cross products with whole vectors."""
    tangent = np.cross(n, whole(rng, len(n), 3, size=3))
    again = ~tangent.any(axis=1)
    tangent[again] = np.cross(n[again], [[1.0, 2.0, 5.0]])
    tangent[~tangent.any(axis=1)] = np.cross(n[~tangent.any(axis=1)], [[1.0, 0.0, 0.0]])
    return Whole(kind, shape, p * UNIT, n, tangent, np.broadcast_to(inside, len(p)))


def sphere(rng: Rng) -> Whole:
    (m, n), c = whole_turn(rng), whole(rng, 3)
    q = ON_BALL @ m.T
    return finished("sphere", Sphere(center=c * UNIT, radius=9.0 * n * UNIT), rng, c + q, q)


def ellipsoid(rng: Rng) -> Whole:
    (m, _), c, s = whole_turn(rng), whole(rng, 3), rng.permutation([1.0, 2.0, 3.0])
    shape = Sphere(to_world=matrix_steps(m * (9.0 * s), c))
    return finished("ellipsoid", shape, rng, c + (ON_BALL * s) @ m.T, (ON_BALL * (6.0 / s)) @ m.T)


def cylinder(rng: Rng, stretch: float = 1.0) -> Whole:
    """Round or elliptic; its length is 8 whole numbers, and the points lie between the ends and on them."""
    (m, _), c, s = whole_turn(rng), whole(rng, 3), np.array([1.0, stretch, 1.0])
    circle = np.repeat(ON_CIRCLE, 3, axis=0)
    height = np.tile([0.0, 3.0, 8.0], len(ON_CIRCLE))
    p = np.column_stack([circle * s[:2], height]) @ m.T
    n = np.column_stack([circle * s[1::-1], np.zeros(len(p))]) @ m.T
    shape = Cylinder(to_world=matrix_steps(m * np.array([5.0, 5.0 * stretch, 8.0]), c))
    name = "cylinder" if stretch == 1.0 else "elliptic cylinder"
    return finished(name, shape, rng, c + p, n, height == 3.0)


def elliptic(rng: Rng) -> Whole:
    return cylinder(rng, 2.0)


def disk(rng: Rng) -> Whole:
    (m, _), c, s = whole_turn(rng), whole(rng, 3), np.array([1.0, 2.0, 1.0])
    q = np.concatenate([IN_CIRCLE, ON_CIRCLE])
    p = np.column_stack([q, np.zeros(len(q))])
    shape = Disk(to_world=matrix_steps(m * (5.0 * s), c))
    return finished("disk", shape, rng, c + (p * s) @ m.T, np.tile(m[:, 2], (len(p), 1)), np.arange(len(q)) < 4)


WEIGHTS = (
    np.array([[2, 1, 1], [1, 2, 1], [1, 1, 2], [0, 2, 2], [3, 1, 0], [1, 0, 3], [4, 0, 0], [0, 4, 0], [0, 0, 4]]) / 4.0
)


def triangle(rng: Rng) -> Whole:
    corners = 4.0 * whole(rng, 3, 3, size=15)
    n = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    if not n.any():
        return triangle(rng)
    p = WEIGHTS @ corners
    return finished(
        "triangle", Triangle(vertices=corners * UNIT), rng, p, np.tile(n / 16.0, (len(p), 1)), (WEIGHTS > 0).all(axis=1)
    )


SQUARE = (
    np.array([[1, 0, 0], [-2, 3, 0], [3, 1, 0], [4, 1, 0], [-4, 0, 0], [2, 4, 0], [4, 4, 0], [-4, 4, 0], [2, -2, 0]])
    / 4.0
)


def rectangle(rng: Rng) -> Whole:
    """The last point is on the diagonal."""
    (m, _), c, s = whole_turn(rng), whole(rng, 3), 4.0 * rng.integers(1, 4, 3)
    p = c + (SQUARE * s) @ m.T
    return finished(
        "rectangle", Rectangle(to_world=matrix_steps(m * s, c)), rng, p, np.tile(m[:, 2], (len(p), 1)), np.arange(9) < 3
    )


def cube(rng: Rng) -> Whole:
    (m, _), c, s = whole_turn(rng), whole(rng, 3), 4.0 * rng.integers(1, 4, 3)
    sides = [(axis, sign) for axis in range(3) for sign in (1.0, -1.0)]
    q = [np.insert(SQUARE[:, :2], axis, sign, axis=1) for axis, sign in sides]
    n = [np.tile(sign * m[:, axis], (len(SQUARE), 1)) for axis, sign in sides]
    p = c + (np.concatenate(q) * s) @ m.T
    return finished(
        "cube", Cube(to_world=matrix_steps(m * s, c)), rng, p, np.concatenate(n), np.tile(np.arange(9) < 3, 6)
    )


def plane(rng: Rng) -> Whole:
    """Across an axis: normals are brought to length 1, and but for the axes none of ours would stay exact."""
    axis, point = int(rng.integers(3)), whole(rng, 3)
    n = np.eye(3)[axis] * rng.choice([-1.0, 1.0])
    beside = whole(rng, 9, 3)
    beside[:, axis] = 0.0
    return finished("plane", Plane(normal=n, point=point * UNIT), rng, point + beside, np.tile(n, (9, 1)))


def coarse_ball(rng: Rng, subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    """(vertices, faces) of a turned icosphere, its corners at multiples of 4 up to 2048."""
    m, n = whole_turn(rng)
    mesh = Icosphere(subdivisions=subdivisions).mesh()
    return 4.0 * np.rint(500.0 / n * mesh.vertices @ m.T), mesh.faces


def ball(rng: Rng) -> Whole:
    """A closed mesh, aimed at within its faces, on its edges and at its corners."""
    vertices, faces = coarse_ball(rng, 1)
    corners = vertices[faces]
    p = np.einsum("wj,fjc->wfc", WEIGHTS, corners).reshape(-1, 3)
    n = np.rint(p / 64.0) + 0.0
    inside = np.repeat((WEIGHTS > 0).all(axis=1), len(faces))
    shape: Mesh = mesh_of(vertices * UNIT, faces)
    return finished("mesh", shape, rng, p, n, inside)


ROUND: tuple[Callable[[Rng], Whole], ...] = (sphere, ellipsoid, cylinder, elliptic)
FLAT: tuple[Callable[[Rng], Whole], ...] = (triangle, rectangle, disk, plane, cube)
ALL = (*ROUND, *FLAT, ball)


def each(rng: Rng, makers: tuple[Callable[[Rng], Whole], ...], times: int = 1) -> Iterator[Whole]:
    for maker in makers:
        for _ in range(times):
            yield maker(rng)

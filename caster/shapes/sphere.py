"""A sphere; under a to_world that stretches it, an ellipsoid."""

import math
from typing import Any, Literal, NamedTuple

import numpy as np

from caster.fields import Positive, Shape, Vec3
from caster.kernels.exact_quadric import exact_ball, exact_sphere, placed
from caster.kernels.exact_root import Root
from caster.kernels.jit import implement, jit
from caster.kernels.protocol import (
    facing,
    hull_point,
    hull_size,
    intersect,
    normal,
    numbers,
    passes,
    plain_normal,
    prepare,
    root,
    same,
    surface,
)
from caster.kernels.roots import (
    approach,
    ball_at,
    chord,
    first_root,
    is_plain,
    is_plain_through,
    plain_way_out,
    straight_way_out,
    way_out,
)
from caster.kernels.vec import (
    SEEN_ERROR,
    U,
    add,
    along,
    angle_fraction,
    by_columns,
    by_rows,
    row,
    row_sizes,
    rows_of,
    seen,
    size,
    sub,
    turned,
    turned_back,
    unit,
)
from caster.placing import Rounding, affine_arrays, is_similarity, size_of_similarity


class Spheres(NamedTuple):
    """Balls in world space."""

    center: np.ndarray  # (n, 3) float64
    radius: np.ndarray  # (n,) float64
    turn: np.ndarray  # (n, 3, 3) float64, rotation from world to the sphere's own axes, for uv


class Ellipsoids(NamedTuple):
    """Images of the unit ball at the origin under p -> center + to_world p."""

    center: np.ndarray  # (n, 3) float64
    to_world: np.ndarray  # (n, 3, 3) float64
    to_object: np.ndarray  # (n, 3, 3) float64, its inverse


class Sphere(Shape):
    """All points at `radius` from `center`. The normal points outwards, under mirrored transforms too."""

    type: Literal["sphere"] = "sphere"
    center: Vec3 = (0.0, 0.0, 0.0)
    radius: Positive = 1.0

    def pack(self, rounded: Rounding) -> Spheres | Ellipsoids:
        linear = self.matrix[:3, :3]
        center = linear @ np.array(self.center) + self.matrix[:3, 3]
        if not is_similarity(linear):
            return Ellipsoids(*affine_arrays(center, self.radius * linear, rounded))
        scale = size_of_similarity(linear)
        turn = linear.T / scale
        return Spheres(rounded(center[None]), rounded(np.array([scale * self.radius])), rounded(turn[None]))


@jit
def around(q: Any) -> tuple[float, float]:
    """uv of a point of the unit ball: turns around z, and the angle from +z over pi."""
    return angle_fraction(q[1], q[0]), math.acos(min(max(q[2], -1.0), 1.0)) / math.pi


@implement(numbers, Spheres)
def _numbers(prims: Any, k: int) -> Any:
    return row(prims.center, k), prims.radius[k]


@implement(prepare, Spheres)
def _prepare(prims: Any, prim: Any, o: Any) -> Any:
    center, r = prim
    f = sub(o, center)
    return ball_at(f, r, U * size(f))


@implement(intersect, Spheres)
def _intersect(prims: Any, pre: Any, d: Any, t_min: float, t_max: float) -> tuple[float, float]:
    return first_root(chord(pre, d, 0.0), t_min, t_max)


@implement(passes, Spheres)
def _passes(prims: Any, pre: Any, d: Any) -> bool:
    return approach(pre, d, 0.0).missed


@implement(same, Spheres)
def _same(prims: Any, k: int, j: int) -> bool:
    return row(prims.center, k) == row(prims.center, j) and prims.radius[k] == prims.radius[j]


@implement(root, Spheres)
def _root(prims: Any, k: int, o: Any, d: Any, t_min: float, t_max: float) -> Root:
    return exact_sphere(row(prims.center, k), prims.radius[k], o, d, t_min, t_max)


@implement(normal, Spheres)
def _normal(prims: Any, k: int, o: Any, d: Any, t: float) -> Any:
    return way_out(sub(o, row(prims.center, k)), d, t, prims.radius[k])


@implement(facing, Spheres)
def _facing(prims: Any, k: int, reach: float) -> Any:
    center, r = row(prims.center, k), prims.radius[k]
    return is_plain(center, r, reach), center, r


@implement(plain_normal, Spheres)
def _plain_normal(prims: Any, face: Any, o: Any, d: Any, t: float) -> Any:
    _, center, r = face
    return straight_way_out(sub(o, center), d, t, r)


@implement(surface, Spheres)
def _surface(prims: Any, k: int, o: Any, d: Any, t: float, wants_uv: bool) -> Any:
    center, r = row(prims.center, k), prims.radius[k]
    n = normal(prims, k, o, d, t)
    u, v = around(turned(prims.turn, k, n)) if wants_uv else (0.0, 0.0)
    return along(center, r, n), n, n, u, v


@implement(hull_size, Spheres)
def _hull_size(prims: Any) -> int:
    return 8


@implement(hull_point, Spheres)
def _hull_point(prims: Any, k: int, j: int) -> Any:
    return along(
        row(prims.center, k), prims.radius[k], (1.0 - 2.0 * (j & 1), 1.0 - (j & 2), 1.0 - 0.5 * (j & 4))
    )


@implement(numbers, Ellipsoids)
def _numbers_ellipsoid(prims: Any, k: int) -> Any:
    m = rows_of(prims.to_object, k)
    return row(prims.center, k), m, SEEN_ERROR * size(row_sizes(m))


@implement(prepare, Ellipsoids)
def _prepare_ellipsoid(prims: Any, prim: Any, o: Any) -> Any:
    """(to_object, the unit ball in object space, by how much d is off there over its size)."""
    center, m, d_off = prim
    f, off = seen(m, sub(o, center))
    return m, ball_at(f, 1.0, size(off)), d_off


@implement(intersect, Ellipsoids)
def _intersect_ellipsoid(prims: Any, pre: Any, d: Any, t_min: float, t_max: float) -> tuple[float, float]:
    m, ball, d_off = pre
    return first_root(chord(ball, by_rows(m, d), d_off * size(d)), t_min, t_max)


@implement(passes, Ellipsoids)
def _passes_ellipsoid(prims: Any, pre: Any, d: Any) -> bool:
    m, ball, d_off = pre
    return approach(ball, by_rows(m, d), d_off * size(d)).missed


@implement(same, Ellipsoids)
def _same_ellipsoid(prims: Any, k: int, j: int) -> bool:
    return False


@implement(root, Ellipsoids)
def _root_ellipsoid(prims: Any, k: int, o: Any, d: Any, t_min: float, t_max: float) -> Root:
    f, e, h, unit = placed(row(prims.center, k), prims.to_world[k], o, d)
    return exact_ball(f, e, h, unit, t_min, t_max)


@implement(normal, Ellipsoids)
def _normal_ellipsoid(prims: Any, k: int, o: Any, d: Any, t: float) -> Any:
    f = turned(prims.to_object, k, sub(o, row(prims.center, k)))
    q = way_out(f, turned(prims.to_object, k, d), t, 1.0)
    return unit(turned_back(prims.to_object, k, q))


@implement(facing, Ellipsoids)
def _facing_ellipsoid(prims: Any, k: int, reach: float) -> Any:
    center, m = row(prims.center, k), rows_of(prims.to_object, k)
    return is_plain_through(m, center, reach), center, m


@implement(plain_normal, Ellipsoids)
def _plain_normal_ellipsoid(prims: Any, face: Any, o: Any, d: Any, t: float) -> Any:
    _, center, m = face
    return unit(by_columns(m, plain_way_out(by_rows(m, sub(o, center)), by_rows(m, d), t, 1.0)))


@implement(surface, Ellipsoids)
def _surface_ellipsoid(prims: Any, k: int, o: Any, d: Any, t: float, wants_uv: bool) -> Any:
    center = row(prims.center, k)
    f = turned(prims.to_object, k, sub(o, center))
    q = way_out(f, turned(prims.to_object, k, d), t, 1.0)
    n = unit(turned_back(prims.to_object, k, q))
    u, v = around(q) if wants_uv else (0.0, 0.0)
    return add(center, turned(prims.to_world, k, q)), n, n, u, v


@implement(hull_size, Ellipsoids)
def _hull_size_ellipsoid(prims: Any) -> int:
    return 8


@implement(hull_point, Ellipsoids)
def _hull_point_ellipsoid(prims: Any, k: int, j: int) -> Any:
    corner = (1.0 - 2.0 * (j & 1), 1.0 - (j & 2), 1.0 - 0.5 * (j & 4))
    return add(row(prims.center, k), turned(prims.to_world, k, corner))

"""A sphere; under a to_world that stretches it, an ellipsoid."""

import math
from typing import Any, Literal, NamedTuple

import numpy as np

from caster.fields import Positive, Shape, Vec3
from caster.kernels.jit import implement
from caster.kernels.protocol import hull_point, hull_size, intersect, prepare, surface
from caster.kernels.roots import ball_roots, first_beyond
from caster.kernels.vec import (
    MISS,
    add,
    along,
    angle_fraction,
    dot,
    row,
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


@implement(prepare, Spheres)
def _prepare(prims: Any, k: int, o: Any) -> Any:
    f = sub(o, row(prims.center, k))
    r = prims.radius[k]
    return f, dot(f, f) - r * r, r


@implement(intersect, Spheres)
def _intersect(prims: Any, pre: Any, d: Any, t_min: float) -> float:
    f, c, r = pre
    near, far, hit = ball_roots(f, d, c, r)
    return first_beyond(t_min, near, far) if hit else MISS


@implement(surface, Spheres)
def _surface(prims: Any, k: int, o: Any, d: Any, t: float) -> Any:
    """The normal is built from the closest approach and the half chord, exact enough for far, small balls."""
    center, r = row(prims.center, k), prims.radius[k]
    f = sub(o, center)
    a = dot(d, d)
    s = -dot(f, d) / a
    closest = along(f, s, d)
    half = math.sqrt(max(r * r - dot(closest, closest), 0.0) / a)
    n = unit(along(closest, -half if t < s else half, d))
    q = turned(prims.turn, k, n)
    v = math.acos(min(max(q[2], -1.0), 1.0)) / math.pi
    return along(center, r, n), n, n, angle_fraction(q[1], q[0]), v


@implement(hull_size, Spheres)
def _hull_size(prims: Any) -> int:
    return 8


@implement(hull_point, Spheres)
def _hull_point(prims: Any, k: int, j: int) -> Any:
    return along(
        row(prims.center, k), prims.radius[k], (1.0 - 2.0 * (j & 1), 1.0 - (j & 2), 1.0 - 0.5 * (j & 4))
    )


@implement(prepare, Ellipsoids)
def _prepare_ellipsoid(prims: Any, k: int, o: Any) -> Any:
    f = turned(prims.to_object, k, sub(o, row(prims.center, k)))
    return k, f, dot(f, f) - 1.0


@implement(intersect, Ellipsoids)
def _intersect_ellipsoid(prims: Any, pre: Any, d: Any, t_min: float) -> float:
    k, f, c = pre
    near, far, hit = ball_roots(f, turned(prims.to_object, k, d), c, 1.0)
    return first_beyond(t_min, near, far) if hit else MISS


@implement(surface, Ellipsoids)
def _surface_ellipsoid(prims: Any, k: int, o: Any, d: Any, t: float) -> Any:
    center = row(prims.center, k)
    q = unit(turned(prims.to_object, k, along(sub(o, center), t, d)))
    n = unit(turned_back(prims.to_object, k, q))
    v = math.acos(min(max(q[2], -1.0), 1.0)) / math.pi
    return add(center, turned(prims.to_world, k, q)), n, n, angle_fraction(q[1], q[0]), v


@implement(hull_size, Ellipsoids)
def _hull_size_ellipsoid(prims: Any) -> int:
    return 8


@implement(hull_point, Ellipsoids)
def _hull_point_ellipsoid(prims: Any, k: int, j: int) -> Any:
    corner = (1.0 - 2.0 * (j & 1), 1.0 - (j & 2), 1.0 - 0.5 * (j & 4))
    return add(row(prims.center, k), turned(prims.to_world, k, corner))

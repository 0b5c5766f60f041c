"""Error propagation through object space, for spheres, ellipsoids, disks and cylinders (docs/method.md, "Quadrics")."""

import functools
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.error_model.intersections import IntersectFunction, Intersections, dot, mat_vec_rows, norm


class ObjectRays(NamedTuple):
    """Rays in the primitive's own coordinates, and what the rounding of getting there scales with."""

    o: np.ndarray  # (m, 3)
    d: np.ndarray  # (m, 3)
    rows: np.ndarray  # (m, 3) length of each row of the inverse matrix
    offset: np.ndarray  # (m, 3) |offset| of each row
    o_size: np.ndarray  # (m,) length of the world origin
    d_size: np.ndarray  # (m,) length of the world direction

    def components(self, t: np.ndarray) -> np.ndarray:
        """(m, 3) magnitudes whose rounding moves the point at t: row . (|o| + |t d|) + |offset|."""
        return self.rows * (self.o_size + np.abs(t) * self.d_size)[:, None] + self.offset


def rays_in_object_space(
    center: np.ndarray, to_object: np.ndarray, o: np.ndarray, d: np.ndarray
) -> ObjectRays:
    """Rays (m, 3) in the object space of primitives with center (m, 3) and inverse matrix (m, 3, 3)."""
    rows = np.sqrt(np.einsum("ijk,ijk->ij", to_object, to_object))
    offset = np.abs(mat_vec_rows(to_object, center))
    return ObjectRays(
        mat_vec_rows(to_object, o - center), mat_vec_rows(to_object, d), rows, offset, norm(o), norm(d)
    )


def ours_through_object_space(
    intersect: IntersectFunction, used: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> IntersectFunction:
    """The model of ours, for kinds whose surface point is found in object space and taken back by to_world.

    Coordinate i is off there by ku components_i, and comes back along column i of the matrix; under a matrix of large
    condition that is far more than t_error and the rounding of o + t d, which it is held to. Components are at least
    |q_i|, so the products with the columns and their sum are covered, too. used: which coordinates are not set to 0.
    """

    return functools.partial(_intersect_ours, intersect, used)


def _intersect_ours(
    intersect: IntersectFunction,
    used: tuple[float, float, float],
    prims: Any,
    k: np.ndarray,
    o: np.ndarray,
    d: np.ndarray,
    ku: float,
) -> tuple[Intersections, ...]:
    rays = rays_in_object_space(prims.center[k], prims.to_object[k], o, d)
    to_world = prims.to_world[k]
    columns = np.sqrt(np.einsum("ijk,ijk->ik", to_world, to_world)) * np.array(used)
    return tuple(
        at._replace(p_error=at.p_error + ku * dot(columns, rays.components(at.t)))
        for at in intersect(prims, k, o, d, ku)
    )


def half_chord_error(s: np.ndarray, r: np.ndarray, error: np.ndarray) -> np.ndarray:
    """How far a root may move when the radius r is off by `error`, s being the true half chord.

    The half chord goes from s to sqrt(s^2 +- e) with e = 2 r E + E^2; near a tangent, where s^2 <= e, it may come
    out of nothing or vanish, and moves by at most sqrt(e).
    """
    change = error * (2.0 * r + error)
    with np.errstate(divide="ignore", invalid="ignore"):
        left = np.sqrt(np.maximum(s * s - change, 0.0))
        return np.where(s * s > change, change / (s + left), np.sqrt(change))


def sphere_roots(f: np.ndarray, d: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(parameter of closest approach, its distance from the centre, half chord or 0 beyond the rim), for |f+td|=r."""
    with np.errstate(divide="ignore", invalid="ignore"):
        middle = -dot(f, d) / dot(d, d)
        distance = norm(f + middle[:, None] * d)
        return middle, distance, np.sqrt(np.maximum((r - distance) * (r + distance), 0.0))


def world_normal(
    to_object: np.ndarray, n: np.ndarray, n_error: np.ndarray, ku: float
) -> tuple[np.ndarray, np.ndarray]:
    """A normal of the unit shape taken to world space, and its bound there."""
    world = np.einsum("ikj,ik->ij", to_object, n)
    length = norm(world)
    size = np.sqrt(np.einsum("ijk,ijk->i", to_object, to_object))
    return world / length[:, None], size / length * (n_error + ku) + ku


def affine_bounds(prims: Any) -> tuple[np.ndarray, np.ndarray]:
    """Boxes around images of a shape that lies in [-1, 1]^3, under p -> center + to_world p."""
    reach = np.abs(prims.to_world).sum(axis=2)
    return prims.center - reach, prims.center + reach

"""Error models of triangles and quadrics: bounds on t, position and normals of Mitsuba's hits (docs/method.md)."""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.error_model.intersections import (
    LARGEST_COORDINATE,
    Array,
    ErrorModel,
    IntersectFunction,
    Intersections,
    UvSpace,
    by_columns,
    cross,
    cross_permanent,
    dot,
    finite_or_zero,
    mat_vec_rows,
    norm,
    plain_uv,
    position_error,
    stacked_columns,
    unit,
    without_edges,
    without_float_warnings,
)
from mitsuba_ref.error_model.tolerances import KU, K
from mitsuba_ref.oracle.exact_kinds import TRIANGLES

# If the relative error of n.d reaches this, float32 does not resolve on which side of edge-on the ray passes.
UNRESOLVABLE = 0.5


def on_plane(t: Array, moved: Array, slope: Array, rho: Array, ku: float) -> tuple[Array, Array, Array]:
    """(t, bound on its error, whether float32 resolves it) of a plane that rounding moves by ku `moved` across itself.

    slope: |n.d|, which is known to a fraction rho of itself. t is 0 where it is not finite and has no bound: of a ray
    that lies in the plane.
    """
    resolvable = rho < UNRESOLVABLE
    t_error = ku * (moved / slope + np.abs(t)) / (1.0 - np.minimum(rho, UNRESOLVABLE))
    t_error = np.where(resolvable, t_error, np.inf)
    return finite_or_zero(t, t_error), t_error, resolvable


@without_float_warnings
def intersect(
    prims: Any, k: Array, o: Array, d: Array, ku: float, *, dependent: bool = False
) -> tuple[Intersections, ...]:
    """Intersections of ray i with triangle k[i], from its plane and its three edge functions.

    dependent: one of the edge functions, any of them, is computed from the two others and inherits their errors.
    """
    corners = [by_columns(prims.vertices[prims.faces[k, j]]) for j in range(3)]
    o, d = by_columns(o), by_columns(d)
    a, b, c = (corner - o for corner in corners)
    across = cross(corners[1] - corners[0], corners[2] - corners[0])  # b - a would carry the rounding of o
    area = norm(across)
    edges, edge_errors = _edge_functions(a, b, c, d, ku)
    if dependent:
        edge_errors = np.repeat(edge_errors.sum(axis=1)[:, None], 3, axis=1)
    total = edges.sum(axis=1)
    weights = edges / total[:, None]
    n = across / area[:, None]
    t = dot(n, a) / dot(n, d)
    settled, t_error, resolvable = _t_and_error(n, across, area, (a, b, c), weights, t, d, ku)
    n_error = ku * (norm(cross_permanent(b - a, c - a)) / area + 1.0)
    traced = (area > 0.0) & np.all([np.abs(corner).max(axis=1) < LARGEST_COORDINATE for corner in corners], axis=0)
    possible = (np.all(edges >= -edge_errors, axis=1) | np.all(edges <= edge_errors, axis=1)) & traced
    inside = edges * np.sign(total)[:, None] > edge_errors
    sure = resolvable & possible & np.isfinite(t)
    weight_errors = (edge_errors + np.abs(weights) * edge_errors.sum(axis=1)[:, None]) / np.abs(total)[:, None]
    sh_n, sh_error = _shading(prims, k, n, n_error, weights, weight_errors, ku)
    p_error = _barycentric_mean(corners, weights, weight_errors, ku)[1]
    uv, uv_error = _uv(prims, k, weights, weight_errors, ku)
    edge, side = _uncertain_edge(corners, inside, np.sign(total), sure)
    certain = inside.all(axis=1) & sure
    hits = settled, t_error, n, n_error, sh_n, sh_error, possible, certain, p_error, uv, uv_error, edge, side
    return (Intersections(*hits),)


@without_float_warnings
def intersect_ours(prims: Any, k: Array, o: Array, d: Array, ku: float) -> tuple[Intersections, ...]:
    """The same for ours, whose position is compared with o + t d: far from the origin, that is rounded more."""
    (at,) = intersect(prims, k, o, d, ku)
    return (at._replace(p_error=at.p_error + position_error(o, d, at.t, at.t_error, ku)),)


@without_float_warnings
def intersect_foreign(prims: Any, k: Array, o: Array, d: Array, ku: float) -> tuple[Intersections, ...]:
    """The same for any usual algorithm and any order of the corners.

    Moeller and Trumbore (1997), "Fast, Minimum Storage Ray/Triangle Intersection", round N in the numerator and in the
    denominator of t = (N . a) / (N . d) by different products; Woop et al. (2013), "Watertight Ray/Triangle
    Intersection", round the corners along other axes than the scene's. With either, the error of N becomes one of t.
    The bounds of position and shading normal, which no candidate gives, are not widened.
    """
    (at,) = intersect(prims, k, o, d, ku, dependent=True)
    a, b, c = (prims.vertices[prims.faces[k, j]] for j in range(3))
    _, middle, longest = np.sort([norm(b - a), norm(c - b), norm(a - c)], axis=0)
    slender = ku * np.nan_to_num(middle * longest / norm(cross(b - a, c - a)) - 1.0, nan=np.inf)
    share, steepness = slender * norm(d), np.abs(dot(at.n, d))
    resolvable = share < UNRESOLVABLE * steepness
    t_error = np.where(resolvable, at.t_error + (np.abs(at.t) * share + longest * slender) / steepness, np.inf)
    return (at._replace(t_error=t_error, n_error=at.n_error + slender, certain=at.certain & resolvable),)


def _barycentric_mean(corners: Sequence[Array], weights: Array, weight_errors: Array, ku: float) -> tuple[Array, Array]:
    """Mean of rows (m, c) at three corners, and its bound: errors of the weights, and rounding of three products.

    The errors of the weights sum to 0, so they act on differences of the corners.
    """
    mean: Array = sum(weights[:, j : j + 1] * corners[j] for j in range(3))
    moved = sum(weight_errors[:, j] * norm(corners[j] - mean) for j in range(3))
    return mean, moved + ku * sum(np.abs(weights[:, j]) * norm(corners[j]) for j in range(3))


def _uncertain_edge(corners: list[Array], inside: Array, facing: Array, sure: Array) -> tuple[Array, Array]:
    """The only edge that leaves a hit in doubt: end points (m, 6), smaller one first, and the triangle's side of it.

    A neighbour on the other side of the same edge is hit where this triangle is not.
    """
    edge, side = np.full((6, len(sure)), np.nan).T, np.zeros(len(sure))
    hanging = sure & (inside.sum(axis=1) == 2)
    for j, (first, last) in enumerate(((2, 1), (0, 2), (1, 0))):  # U belongs to the edge from c to b, and so on
        rows = np.flatnonzero(hanging & ~inside[:, j])
        start, end = corners[first][rows], corners[last][rows]
        swapped = np.array([p > q for p, q in zip(start.tolist(), end.tolist(), strict=True)], bool)
        edge[rows] = np.where(swapped[:, None], np.hstack([end, start]), np.hstack([start, end]))
        side[rows] = facing[rows] * np.where(swapped, -1.0, 1.0)
    return edge, side


def _edge_functions(a: Array, b: Array, c: Array, d: Array, ku: float) -> tuple[Array, Array]:
    """(m, 3) edge functions U, V, W = d.(b x c), ... and their error bounds.

    Three sources of error: corners relative to the origin are rounded, each component by u of itself, which moves U by
    |c||b x d| + |b||c x d|; Embree computes U from the difference and the sum of two corners (Pluecker), whose products
    are rounded; and its robust mode accepts |U + V + W| ulps beyond an edge.
    """
    pairs = ((c, b), (a, c), (b, a))
    edges = stacked_columns(*(dot(d, cross(p - q, q)) for p, q in pairs))  # p x q, with less to cancel
    inflation = 2.0 * np.abs(edges.sum(axis=1))
    errors = [
        dot(np.abs(d), cross_permanent(p - q, np.abs(p) + np.abs(q)))
        + dot(np.abs(p), np.abs(cross(q, d)))
        + dot(np.abs(q), np.abs(cross(p, d)))
        + inflation
        for p, q in pairs
    ]
    return edges, ku * stacked_columns(*errors)


def _t_and_error(
    n: Array,
    across: Array,
    area: Array,
    corners: tuple[Array, Array, Array],
    weights: Array,
    t: Array,
    d: Array,
    ku: float,
) -> tuple[Array, Array, Array]:
    """As on_plane.

    Three sources of error: rounded corners move the plane (displacement); the rounded normal tilts it about the first
    corner (lever); and n.d is only known to a fraction rho of itself. A corner moved by e changes N.d by
    e . (opposite edge x d). Corners are rounded once, relative to the ray's origin, and not K times: this tilt is most
    of rho for a distant triangle seen edge-on.
    """
    a, b, c = corners
    steepness = np.abs(dot(n, d))
    spread = cross_permanent(b - a, c - a) / area[:, None]
    reach = np.abs(t)[:, None] * np.abs(d)
    share = [np.abs(weights[:, j : j + 1]) * np.abs(corner) for j, corner in enumerate(corners)]
    displacement = dot(np.abs(n), sum(share) + np.abs(a) + reach)
    lever = dot(np.abs(t[:, None] * d - a), spread)
    opposite = ((a, b - c), (b, c - a), (c, a - b))
    tilt = sum(dot(np.abs(corner), np.abs(cross(edge, d))) for corner, edge in opposite) / area
    rho = ku * (dot(np.abs(n), np.abs(d)) + dot(np.abs(d), spread) + tilt / K) / steepness
    return on_plane(t, displacement + lever, steepness, rho, ku)


def _shading(
    prims: Any, k: Array, n: Array, n_error: Array, weights: Array, weight_errors: Array, ku: float
) -> tuple[Array, Array]:
    """Interpolated normal and its bound, with the rounding of its length."""
    normals = [by_columns(prims.normals[prims.faces[k, j]]) for j in range(3)]
    summed, summed_error = _barycentric_mean(normals, weights, weight_errors, ku)
    length, smooth = norm(summed), prims.smooth[k]
    error = np.where(smooth, summed_error / np.where(length > 0.0, length, np.nan) + ku, n_error)
    return np.where(smooth[:, None], unit(summed), n), error


BARYCENTRIC_UV = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])  # uv of faces that have none, on both sides


def _uv(prims: Any, k: Array, weights: Array, weight_errors: Array, ku: float) -> tuple[Array, Array]:
    corners = [np.broadcast_to(corner, (len(k), 2)) for corner in BARYCENTRIC_UV]
    textured = prims.textured[k]
    if textured.any():
        given = [by_columns(prims.uv[prims.faces[k, j]]) for j in range(3)]
        corners = [np.where(textured[:, None], *pair) for pair in zip(given, corners, strict=True)]
    uv, uv_error = _barycentric_mean(corners, weights, weight_errors, ku)
    return plain_uv(prims, k, uv), uv_error


MODEL = ErrorModel(intersect, TRIANGLES, intersect_ours, intersect_foreign=intersect_foreign)


# ---- quadrics ----


class ObjectRays(NamedTuple):
    """Rays in the primitive's own coordinates, and the magnitudes that rounding of the transform scales with."""

    o: Array  # (m, 3)
    d: Array  # (m, 3)
    rows: Array  # (m, 3) length of each row of the inverse matrix
    offset: Array  # (m, 3) magnitude of each component of the inverse's translation: its products, not their sum
    o_size: Array  # (m,) length of the world origin
    d_size: Array  # (m,) length of the world direction

    def components(self, t: Array) -> Array:
        """(m, 3) magnitudes that rounding of the point at t scales with: row . (|o| + |t d|) + |offset|."""
        return self.rows * (self.o_size + np.abs(t) * self.d_size)[:, None] + self.offset


# (center, to_object, o, d) -> rays of the primitives' object space
RayTransform = Callable[[Array, Array, Array, Array], ObjectRays]


def rays_in_object_space(center: Array, to_object: Array, o: Array, d: Array) -> ObjectRays:
    """Rays (m, 3) in the object space of primitives with center (m, 3) and inverse matrix (m, 3, 3)."""
    rows = np.sqrt(np.einsum("ijk,ijk->ij", to_object, to_object))
    offset = mat_vec_rows(np.abs(to_object), np.abs(center))
    return ObjectRays(mat_vec_rows(to_object, o - center), mat_vec_rows(to_object, d), rows, offset, norm(o), norm(d))


def rays_about_center(center: Array, to_object: Array, o: Array, d: Array) -> ObjectRays:
    """The same for ours, which transforms o - center: a difference that is rounded relative to its own length."""
    rays = rays_in_object_space(center, to_object, o, d)
    return rays._replace(o_size=np.maximum(rays.o_size, norm(o - center)))


def ours_through_object_space(
    intersect: Callable[..., tuple[Intersections, ...]], used: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> IntersectFunction:
    """The error model for ours, for kinds whose surface point is computed in object space and transformed back.

    Coordinate i is off by ku components_i there, which moves the point along column i of the matrix; under a matrix of
    large condition that is far more than t_error and the rounding of o + t d, which it is compared with. Components are
    at least |q_i|, so the products with the columns and their sum are covered, too. used: 0 for coordinates that the
    kind sets to 0.
    """

    def intersect_ours(prims: Any, k: Array, o: Array, d: Array, ku: float) -> tuple[Intersections, ...]:
        rays = rays_about_center(prims.center[k], prims.to_object[k], o, d)
        to_world = prims.to_world[k]
        columns = np.sqrt(np.einsum("ijk,ijk->ik", to_world, to_world)) * np.array(used)
        return tuple(
            at._replace(p_error=at.p_error + ku * dot(columns, rays.components(at.t)))
            for at in intersect(prims, k, o, d, ku, rays_about_center)
        )

    return intersect_ours


@without_float_warnings
def half_chord_error(s: Array, r: Array, error: Array) -> Array:
    """Bound on the change of the half chord s if the radius r is off by `error`.

    The half chord changes from s to sqrt(s^2 +- e) with e = 2 r E + E^2. Near a tangent, where s^2 <= e, it may appear
    or vanish, and changes by at most sqrt(e).
    """
    return root_change(s, error * (2.0 * r + error))


def root_change(s: Array, change: Array) -> Array:
    """How far the root of s^2 changes if s^2 changes by `change`."""
    left = np.sqrt(np.maximum(s * s - change, 0.0))
    return np.where(s * s > change, change / (s + left), np.sqrt(change))


@without_float_warnings
def sphere_roots(f: Array, d: Array, r: Array) -> tuple[Array, Array, Array]:
    """Roots of |f + t d| = r as (t of the closest approach, its distance from the centre, half chord; 0 if missed)."""
    middle = -dot(f, d) / dot(d, d)
    distance = norm(f + middle[:, None] * d)
    return middle, distance, np.sqrt(np.maximum((r - distance) * (r + distance), 0.0))


def world_normal(to_object: Array, n: Array, n_error: Array, ku: float) -> tuple[Array, Array]:
    """Normals of the unit shape in world space, and their error bounds there."""
    world = np.einsum("ikj,ik->ij", to_object, n)
    length = norm(world)
    size = np.sqrt(np.einsum("ijk,ijk->i", to_object, to_object))
    return world / length[:, None], size / length * (n_error + ku) + ku


# b^2 / a and c of a quadratic equation each take two products of three terms: twice K roundings of their size.
QUADRATIC_ROUNDINGS = 2.0


@without_float_warnings
def intersect_round(
    prims: Any,
    k: Array,
    o: Array,
    d: Array,
    ku: float,
    transformed: RayTransform = rays_in_object_space,
    *,
    ends: bool,
    float32: bool = False,
) -> tuple[Intersections, ...]:
    """Intersections of ray i with ellipsoid or cylinder k[i]: a unit sphere, or circle with two ends, in object space.

    Mitsuba 3.9.1 moves the origin of a ray to its closest approach to the centre of an ellipsoid, to avoid
    cancellation, but takes the distance to that point for its parameter. If d is longer than 1 in object space, it
    overshoots, and rounds there. It projects hits onto an ellipsoid along the radius in object space, which may be far
    longer in world space. It moves hits onto the wall of a cylinder by their distance from it in object space: along
    the radius there for an instance; otherwise along the normal by as many scene units, which moves points of thin
    cylinders far.

    float32: as its `ellipsoids` do it, which solve a s^2 + 2 b s + c = 0 from there in float32: b^2 / a and c are
    rounded by the square of the distance to the centre. It is far more than 1 for a small ellipsoid far away, since
    they too take a distance for the parameter. Hits are not projected.
    """
    to_object = prims.to_object[k]
    rays = transformed(prims.center[k], to_object, o, d)
    used, one, found = np.array([1.0, 1.0, 0.0 if ends else 1.0]), np.ones(len(k)), []
    middle, distance, s = sphere_roots(rays.o * used, rays.d * used, one)
    size = norm(rays.d * used)
    beyond = np.abs(size - 1.0) if float32 else np.maximum(size - 1.0, 0.0)
    overshoot = 0.0 * size if ends else np.abs(middle) * size * beyond
    for side in (-1.0, 1.0):
        t = middle + side * s / size
        q, components = rays.o + t[:, None] * rays.d, rays.components(t)
        error = ku * (components[:, 0] + components[:, 1] if ends else norm(components) + overshoot + 1.0)
        change = error * (2.0 + error)
        if float32:
            change += QUADRATIC_ROUNDINGS * ku * (overshoot * overshoot + distance * distance + 1.0)
        t_error = root_change(s, change) / size + ku * (np.abs(t) + overshoot / size)
        out = q * used / np.maximum(distance, 1.0)[:, None]
        across = np.abs(dot(out, rays.d))
        slide = np.sqrt(np.maximum(size * size - across**2, 0.0))
        moved = error + slide * t_error
        if float32:  # not projected: the exact tangent of its angle, as the displacement may be large
            moved /= np.maximum(1.0 - across * t_error - error, ku)
        n, n_error = world_normal(to_object, out, moved, ku)
        possible, certain = distance * distance - 1.0 <= change, s * s > change
        if float32:
            n_error /= np.maximum(1.0 - n_error, ku)
        pull = 0.0 * size if float32 else norm(mat_vec_rows(prims.to_world[k], out))
        if ends:
            end_error = ku * components[:, 2] + np.abs(rays.d[:, 2]) * t_error
            inside = np.minimum(q[:, 2], 1.0 - q[:, 2])
            possible, certain = possible & (inside >= -end_error), certain & (inside > end_error)
            pull = np.maximum(pull, 1.0)
            uv, uv_error = np.column_stack([out[:, :2], q[:, 2]]), moved + end_error + TURN * ku
        else:
            uv, uv_error = sphere_uv(out, moved, ku)
        away = error + across * t_error + 0.5 * (slide * t_error) ** 2
        p_error = position_error(o, d, t, t_error, ku) + pull * away
        found.append(without_edges(t, t_error, n, n_error, possible, certain, p_error, uv, uv_error))
    return tuple(found)


# With reach = |o| + |center|, and size the length in object space of a direction along the shortest semi-axis, a ray
# starts at most size reach from the centre there. Its components, of |o| + |t d| and of the centre, are at most
# 2 sqrt(3) size reach, and its overshoot is size reach beyond. `intersect_round` finds it possible up to the distance
# 1 + error + sqrt(change).
COMPONENTS_PER_REACH = 2.0 * math.sqrt(3.0)


@without_float_warnings
def growth_of_ellipsoids(prims: Any, *, float32: bool = False) -> Array:
    """(m,) ErrorModel.growth of ellipsoids. float32: as in intersect_round."""
    longest, _, shortest = np.linalg.svd(prims.to_world, compute_uv=False).T
    size = 1.0 / shortest
    beyond = np.maximum(size - 1.0, 1.0 - 1.0 / longest if float32 else 0.0)
    off = KU * (beyond + COMPONENTS_PER_REACH)
    if float32:
        off += math.sqrt(QUADRATIC_ROUNDINGS * KU) * beyond
    return np.asarray(longest * size * off)


# ---- uv of quadrics ----
#
# An angle takes an arc tangent, a sum and a quotient, each rounded by less than u of up to a turn. As a point at
# distance r from the axis, it is off by at most ku r TURN, in addition to the error of the surface point.
TURN = 2.0 * math.pi


def on_circle(fraction: Array, whole_turn: bool = False) -> Array:
    """(m, 2) points of the unit circle at fractions of a turn; NaN outside of [0, 1).

    whole_turn: 1 is allowed, since the reference adds 2 pi to angles below 0, which may round to 2 pi.
    """
    inside = (fraction >= 0.0) & ((fraction <= 1.0) if whole_turn else (fraction < 1.0))
    angle = TURN * np.where(inside, fraction, np.nan)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def sphere_uv_points(_prims: Any, _k: Array, uv: Array, whole_turn: bool = False) -> Array:
    """Points of the unit sphere with u the azimuth as a fraction of a turn, v the polar angle over pi."""
    polar = math.pi * np.where((uv[:, 1] >= 0.0) & (uv[:, 1] <= 1.0), uv[:, 1], np.nan)
    return np.column_stack([np.sin(polar)[:, None] * on_circle(uv[:, 0], whole_turn), np.cos(polar)])


@without_float_warnings
def sphere_uv(q: Array, error: Array, ku: float) -> tuple[Array, Array]:
    """Points (m, 3) of the unit sphere for the uv of q, and their bound if q is off by `error`.

    q has length 1 up to rounding: v is the arc cosine of its height z, and s = sqrt(1 - z^2) the distance from the
    axis. Like a half chord, s is off by far more than z near a pole. The azimuth is off by an angle of
    asin(error / |q across|), whose chord is at most sqrt(2) times that ratio, and at most 2.
    """
    z, across = np.clip(q[:, 2], -1.0, 1.0), np.hypot(q[:, 0], q[:, 1])
    s = np.sqrt((1.0 - z) * (1.0 + z))
    away = np.where(across[:, None] > 0.0, q[:, :2] / across[:, None], np.array([1.0, 0.0]))
    turned = np.fmin(2.0, math.sqrt(2.0) * error / across)
    risen = half_chord_error(s, np.ones(len(s)), error) + error
    return stacked_columns(*(s * away.T), z), s * turned + risen + TURN * ku


SPHERE_UV = UvSpace(sphere_uv_points, functools.partial(sphere_uv_points, whole_turn=True))

"""Sphere: to Mitsuba's sphere, or an instance of one where it is stretched; and its error model."""

from typing import Any

import numpy as np

from caster.shapes.sphere import Ellipsoids, Sphere, Spheres
from mitsuba_ref.error_model.independent_transform import expected_sphere
from mitsuba_ref.error_model.intersections import (
    ErrorModel,
    Intersections,
    dot,
    mat_vec_rows,
    norm,
    position_error,
)
from mitsuba_ref.oracle.exact_quadrics import ELLIPSOIDS, SPHERES
from mitsuba_ref.reference.xml_writer import ShapeWriter, XmlElement
from mitsuba_ref.shapes.quadric_error import (
    affine_bounds,
    half_chord_error,
    ours_through_object_space,
    rays_in_object_space,
    sphere_roots,
    world_normal,
)
from mitsuba_ref.shapes.shape_reference import ShapeReference


def to_xml(out: ShapeWriter, shape: Sphere, part: Any) -> list[XmlElement]:
    """Centre and radius as one matrix; an ellipsoid as an instance, since Mitsuba's sphere takes no stretching."""
    if isinstance(part, Ellipsoids):
        return out.instance(shape, "sphere", part)
    scale = part.radius[0] * np.eye(3)
    return [out.native(shape, "sphere", part.center[0], scale)]


def intersect(
    prims: Any, k: np.ndarray, o: np.ndarray, d: np.ndarray, ku: float
) -> tuple[Intersections, ...]:
    """Ray i with ball k[i]: near root, far root."""
    center, r = prims.center[k], prims.radius[k]
    middle, distance, s = sphere_roots(o - center, d, r)
    return tuple(_meeting(center, r, o, d, (middle, distance, s), side, ku) for side in (-1.0, 1.0))


def _meeting(
    center: np.ndarray,
    r: np.ndarray,
    o: np.ndarray,
    d: np.ndarray,
    root: tuple[np.ndarray, np.ndarray, np.ndarray],
    side: float,
    ku: float,
) -> Intersections:
    middle, distance, s = root
    size = norm(d)
    t = middle + side * s / size
    n = (o - center + t[:, None] * d) / np.maximum(distance, r)[:, None]
    reach = np.abs(o) + np.abs(t)[:, None] * np.abs(d) + np.abs(center)
    error = ku * (dot(np.abs(n), reach) + r)
    t_error = half_chord_error(s, r, error) / size + ku * np.abs(t)
    slide = np.sqrt(np.maximum(size * size - dot(n, d) ** 2, 0.0))
    n_error = (ku * norm(reach) + slide * t_error) / r + 0.5 * ku
    possible, certain = distance - r <= error, r - distance > error
    p_error = position_error(o, d, t, t_error, ku)
    return Intersections(t, t_error, n, n_error, n, n_error, possible, certain, p_error)


def meet_ellipsoid(
    prims: Any, k: np.ndarray, o: np.ndarray, d: np.ndarray, ku: float
) -> tuple[Intersections, ...]:
    """Ray i with ellipsoid k[i]: the unit ball in object space, where the ray arrives rounded.

    Mitsuba 3.9.1 moves a ray's origin to where it passes the centre, so that little cancels; but it takes the
    distance to there for the parameter. Where d is longer than 1 in object space, it overshoots, and rounds there.
    """
    to_object = prims.to_object[k]
    rays = rays_in_object_space(prims.center[k], to_object, o, d)
    middle, distance, s = sphere_roots(rays.o, rays.d, np.ones(len(k)))
    size = norm(rays.d)
    overshoot = np.abs(middle) * size * np.maximum(size - 1.0, 0.0)
    found = []
    for side in (-1.0, 1.0):
        t = middle + side * s / size
        q = (rays.o + t[:, None] * rays.d) / np.maximum(distance, 1.0)[:, None]
        error = ku * (norm(rays.components(t)) + overshoot + 1.0)
        t_error = half_chord_error(s, np.ones(len(k)), error) / size + ku * (np.abs(t) + overshoot / size)
        slide = np.sqrt(np.maximum(size * size - dot(q, rays.d) ** 2, 0.0))
        n, n_error = world_normal(to_object, q, error + slide * t_error, ku)
        possible, certain = distance - 1.0 <= error, 1.0 - distance > error
        # Mitsuba pulls the point onto the unit ball along its radius, which may be far longer in the world.
        away = error + np.abs(dot(q, rays.d)) * t_error + 0.5 * (slide * t_error) ** 2
        pulled = norm(mat_vec_rows(prims.to_world[k], q)) * away
        p_error = position_error(o, d, t, t_error, ku) + pulled
        found.append(Intersections(t, t_error, n, n_error, n, n_error, possible, certain, p_error))
    return tuple(found)


def sphere_bounds(prims: Spheres) -> tuple[np.ndarray, np.ndarray]:
    r = prims.radius[:, None]
    return prims.center - r, prims.center + r


REFERENCE = ShapeReference(
    Sphere,
    to_xml,
    {
        Spheres: ErrorModel(intersect, sphere_bounds, exact=SPHERES),
        Ellipsoids: ErrorModel(
            meet_ellipsoid, affine_bounds, ours_through_object_space(meet_ellipsoid), exact=ELLIPSOIDS
        ),
    },
    expected_sphere,
    analytic=True,
)

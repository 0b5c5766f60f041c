"""Cylinder: Mitsuba's cylinder, or an instance of one where it is stretched; and its error model."""

from typing import Any

import numpy as np

from caster.shapes.cylinder import Cylinder, Cylinders
from mitsuba_ref.error_model.independent_transform import expected_cylinder
from mitsuba_ref.error_model.intersections import (
    ErrorModel,
    Intersections,
    U,
    dot,
    mat_vec_rows,
    norm,
    position_error,
)
from mitsuba_ref.oracle.exact_quadrics import CYLINDERS
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


def to_xml(out: ShapeWriter, shape: Cylinder, part: Any) -> list[XmlElement]:
    """A round, straight cylinder as it is; a stretched, sheared or mirrored one as an instance."""
    if mitsuba_accepts_matrix(part.to_world[0]):
        return [out.native(shape, "cylinder", part.center[0], part.to_world[0])]
    return out.instance(shape, "cylinder", part)


# Mitsuba refuses a cylinder whose matrix, as rotation times stretching, shears by more than this many scene units.
LARGEST_SHEAR = 1e-6
SHEAR_ROUNDING = (
    8 * U
)  # of the matrix's own size: by how much float32 shears one that has no shear, here and there


def mitsuba_accepts_matrix(linear: np.ndarray) -> bool:
    """Whether Mitsuba takes a 3x3 matrix for that of a round, straight cylinder which keeps its outside outside."""
    stretch = np.array(polar_decomposition(linear)[1])
    shear = np.max(np.abs([stretch[0, 1], stretch[0, 2], stretch[1, 2], stretch[0, 0] - stretch[1, 1]]))
    rounding = SHEAR_ROUNDING * np.max(np.abs(stretch))
    return bool(shear <= rounding and shear + rounding <= LARGEST_SHEAR and np.linalg.det(linear) > 0.0)


def polar_decomposition(linear: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(rotation, symmetric stretching) whose product is the matrix."""
    u, sizes, v = np.linalg.svd(linear)
    return u @ v, v.T @ np.diag(sizes) @ v


def intersect(
    prims: Any, k: np.ndarray, o: np.ndarray, d: np.ndarray, ku: float
) -> tuple[Intersections, ...]:
    """Ray i with tube k[i]: the unit circle in the x, y of object space, then the ends."""
    to_object = prims.to_object[k]
    rays = rays_in_object_space(prims.center[k], to_object, o, d)
    flat = np.array([1.0, 1.0, 0.0])
    one = np.ones(len(k))
    middle, distance, s = sphere_roots(rays.o * flat, rays.d * flat, one)
    size = norm(rays.d * flat)
    found = []
    # Mitsuba 3.9.1 pulls a hit onto the wall by its distance from it in object space: along the radius there, if it
    # is an instance; or else along the normal, by as many scene units, which moves points of thin cylinders far.
    with np.errstate(divide="ignore", invalid="ignore"):
        for side in (-1.0, 1.0):
            t = middle + side * s / size
            q = rays.o + t[:, None] * rays.d
            components = rays.components(t)
            error = ku * (components[:, 0] + components[:, 1])
            t_error = half_chord_error(s, one, error) / size + ku * np.abs(t)
            end_error = ku * components[:, 2] + np.abs(rays.d[:, 2]) * t_error
            out = q * flat / np.maximum(distance, 1.0)[:, None]
            slide = np.sqrt(np.maximum(size * size - dot(out, rays.d) ** 2, 0.0))
            n, n_error = world_normal(to_object, out, error + slide * t_error, ku)
            inside = np.minimum(q[:, 2], 1.0 - q[:, 2])
            possible = (distance - 1.0 <= error) & (inside >= -end_error)
            certain = (1.0 - distance > error) & (inside > end_error)
            pull = np.maximum(norm(mat_vec_rows(prims.to_world[k], out)), 1.0)
            away = error + np.abs(dot(out, rays.d)) * t_error + 0.5 * (slide * t_error) ** 2
            p_error = position_error(o, d, t, t_error, ku) + pull * away
            found.append(Intersections(t, t_error, n, n_error, n, n_error, possible, certain, p_error))
    return tuple(found)


MODEL = ErrorModel(intersect, affine_bounds, ours_through_object_space(intersect), exact=CYLINDERS)
REFERENCE = ShapeReference(Cylinder, to_xml, {Cylinders: MODEL}, expected_cylinder, analytic=True)

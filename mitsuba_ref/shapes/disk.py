"""Disk: Mitsuba's disk, which takes any matrix; and its error model."""

from typing import Any

import numpy as np

from caster.shapes.disk import Disk, Disks
from mitsuba_ref.error_model.independent_transform import expected_disk
from mitsuba_ref.error_model.intersections import (
    ErrorModel,
    Intersections,
    finite_or_zero,
    norm,
    position_error,
)
from mitsuba_ref.oracle.exact_planar import DISKS
from mitsuba_ref.reference.xml_writer import ShapeWriter, XmlElement
from mitsuba_ref.shapes.quadric_error import (
    affine_bounds,
    ours_through_object_space,
    rays_in_object_space,
    world_normal,
)
from mitsuba_ref.shapes.shape_reference import ShapeReference
from mitsuba_ref.shapes.triangle_error import UNRESOLVABLE


def to_xml(out: ShapeWriter, shape: Disk, part: Any) -> list[XmlElement]:
    return [out.native(shape, "disk", part.center[0], part.to_world[0])]


def intersect(
    prims: Any, k: np.ndarray, o: np.ndarray, d: np.ndarray, ku: float
) -> tuple[Intersections, ...]:
    """Ray i with disk k[i]: the plane z = 0 of object space, then the rim."""
    to_object = prims.to_object[k]
    rays = rays_in_object_space(prims.center[k], to_object, o, d)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = -rays.o[:, 2] / rays.d[:, 2]
        components, slope = rays.components(t), np.abs(rays.d[:, 2])
        rho = ku * rays.rows[:, 2] * rays.d_size / slope
        resolvable = rho < UNRESOLVABLE
        t_error = ku * (components[:, 2] / slope + np.abs(t)) / (1.0 - np.minimum(rho, UNRESOLVABLE))
        t_error = np.where(resolvable, t_error, np.inf)
        q = rays.o + t[:, None] * rays.d
        rim = np.hypot(q[:, 0], q[:, 1])
        rim_error = ku * (components[:, 0] + components[:, 1]) + t_error * norm(rays.d[:, :2])
        possible, certain = ~(rim - 1.0 > rim_error), (1.0 - rim > rim_error) & resolvable
    up = np.tile([0.0, 0.0, 1.0], (len(k), 1))
    n, n_error = world_normal(to_object, up, np.zeros(len(k)), ku)
    t = finite_or_zero(t, t_error)
    p_error = position_error(o, d, t, t_error, ku)
    return (Intersections(t, t_error, n, n_error, n, n_error, possible, certain, p_error),)


MODEL = ErrorModel(
    intersect, affine_bounds, ours_through_object_space(intersect, used=(1.0, 1.0, 0.0)), exact=DISKS
)
REFERENCE = ShapeReference(Disk, to_xml, {Disks: MODEL}, expected_disk, analytic=True)

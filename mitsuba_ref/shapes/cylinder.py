"""Cylinders: Mitsuba's cylinder, or an instance of one if stretched; error model and targets."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from caster.shapes.cylinder import Cylinder, Cylinders
from mitsuba_ref.error_model.defect_conditions import (
    ALONG_AXIS_SINE,
    STARTS_ON_CURVED,
    STRETCHED,
    DefectView,
    KnownDefect,
    far_from_origin,
    small_and_far,
)
from mitsuba_ref.error_model.independent_transform import ExpectedNumbers, expected_points
from mitsuba_ref.error_model.intersections import Array, ErrorModel, UvSpace, by_matrix
from mitsuba_ref.error_model.tolerances import U32
from mitsuba_ref.oracle.exact_kinds import CYLINDERS as EXACT_CYLINDERS
from mitsuba_ref.scene_xml.elements import ShapeWriter, XmlElement
from mitsuba_ref.shapes.shape_reference import Fields, PrimitiveReference, ShapeReference, describe_unit_shape
from mitsuba_ref.shapes.surface_errors import intersect_round, on_circle, ours_through_object_space
from mitsuba_ref.shapes.targets import (
    BESIDE_DECADES,
    Rng,
    SurfacePoints,
    coin_flip,
    on_unit_shape,
    random_fractions,
    random_length,
    random_point,
    unit_circle_points,
)


def to_xml(out: ShapeWriter, shape: Cylinder, part: Any) -> list[XmlElement]:
    """A native cylinder if it is round, straight and not mirrored; otherwise an instance of one."""
    if mitsuba_accepts_matrix(part.to_world[0]):
        return out.native(shape, "cylinder", part.center, part.to_world)
    return out.instances(shape, "cylinder", part)


# Mitsuba rejects a cylinder if its matrix, as rotation times stretch, shears by more than this (scene units).
LARGEST_SHEAR = 1e-6
SHEAR_ROUNDING = 8 * U32  # shear of a matrix without any that float32 rounding causes, relative to its size


def mitsuba_accepts_matrix(linear: Array) -> bool:
    """Whether Mitsuba accepts a 3x3 matrix as that of a round, straight cylinder that is not mirrored."""
    _, sizes, v = np.linalg.svd(linear)
    stretch = v.T @ np.diag(sizes) @ v
    shear = np.max(np.abs([stretch[0, 1], stretch[0, 2], stretch[1, 2], stretch[0, 0] - stretch[1, 1]]))
    rounding = SHEAR_ROUNDING * np.max(np.abs(stretch))
    return bool(shear <= rounding and shear + rounding <= LARGEST_SHEAR and np.linalg.det(linear) > 0.0)


def uv_points(_prims: Any, _k: Array, uv: Array, whole_turn: bool = False) -> Array:
    """Points of the unit cylinder with u the angle as a fraction of a turn, v the height."""
    return np.column_stack([on_circle(uv[:, 0], whole_turn), uv[:, 1]])


intersect = partial(intersect_round, ends=True)


# A matrix with a larger condition number than this may change its handedness when rounded to float32.
LARGEST_HANDED_CONDITION = 2.0**20


def expected_cylinder(shape: Any, part: Any) -> Iterator[ExpectedNumbers]:
    """Base, axis, handedness, and A A^T, which does not depend on where around the axis the angle starts."""
    linear, packed = shape.matrix[:3, :3], part.to_world[0]
    axis = np.subtract(shape.p1, shape.p0)
    ends = np.abs(shape.p0) + np.abs(shape.p1)
    across = np.eye(3) - np.outer(axis, axis) / np.dot(axis, axis)
    own = shape.radius**2 * across + np.outer(axis, axis)
    reach = np.abs(linear).sum(axis=1) * (shape.radius + ends.max())
    yield expected_points(shape, "p0", part.center, np.array([shape.p0]))
    yield ExpectedNumbers("axis", packed[:, 2], linear @ axis, np.abs(linear) @ ends)
    yield ExpectedNumbers("radius", packed @ packed.T, linear @ own @ linear.T, np.outer(reach, reach))
    hands = np.sign(np.linalg.det(packed)), np.sign(np.linalg.det(linear))
    yield ExpectedNumbers(
        "handedness", *hands, np.where(np.linalg.cond(packed) < LARGEST_HANDED_CONDITION, 0.0, np.inf)
    )


def unit_cylinder_points(rng: Rng, count: int, sort: str) -> SurfacePoints:
    c, s = unit_circle_points(rng, count)
    zero, one = np.zeros(count), np.ones(count)
    z = rng.integers(0, 2, count).astype(float) if sort in ("corner", "beside") else random_fractions(rng, count)[:, 0]
    if sort == "beside":
        z += 10.0 ** rng.uniform(*BESIDE_DECADES, count) * np.where(z > 0.0, 1.0, -1.0)
    around, upright = np.column_stack([-s, c, zero]), np.column_stack([zero, zero, one])
    along = np.where(rng.random((count, 1)) < 0.5, around, upright)
    return SurfacePoints(np.column_stack([c, s, z]), along, np.column_stack([c, s, zero]))


def random_fields(rng: Rng, lattice: bool) -> Fields:
    if coin_flip(rng):
        return {}
    p0, p1 = random_point(rng, lattice), random_point(rng, lattice)
    if p0 == p1:
        p1[2] += 1.0
    return {"p0": p0, "p1": p1, "radius": random_length(rng, lattice)}


def view_cylinder(prims: Any, k: int, o: Array, d: Array, t: float) -> DefectView:
    axis = prims.to_world[k][:, 2]
    sine = np.linalg.norm(np.cross(axis, d)) / (np.linalg.norm(axis) * np.linalg.norm(d))
    return DefectView(axis_angle=float(sine), stretch=float(np.linalg.norm(prims.to_object[k] @ d)))


CYLINDERS = PrimitiveReference(
    Cylinders,
    ErrorModel(
        intersect,
        EXACT_CYLINDERS,
        ours_through_object_space(intersect),
        UvSpace(uv_points, partial(uv_points, whole_turn=True)),
    ),
    describe_unit_shape("cylinder"),
    on_unit_shape(unit_cylinder_points),
    derived=("to_object",),
    rounding_groups=(by_matrix,),
    known_defects=(
        STARTS_ON_CURVED,
        KnownDefect(
            55, "a cylinder that a ray touches along its wall, exactly", 6, lambda m: "tangent" in m.where, "missed"
        ),
        KnownDefect(56, "a ray through the end of a cylinder, exactly", 9, lambda m: "rim" in m.where, "missed"),
        KnownDefect(
            53, "a ray nearly along the axis of a cylinder", 14, lambda m: m.axis_angle < ALONG_AXIS_SINE and m.nearly
        ),
        STRETCHED,
        KnownDefect(57, "a cylinder that is thin and far away", 16, small_and_far),
        KnownDefect(61, "a cylinder far from the origin", 22, far_from_origin),
    ),
    defect_view=view_cylinder,
)
REFERENCE = ShapeReference(
    Cylinder, to_xml, (CYLINDERS,), expected_cylinder, random_fields, groups=("quadric", "small"), analytic=True
)

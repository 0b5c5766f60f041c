"""Disks: Mitsuba's disk under any matrix; error model and targets."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from caster.shapes.disk import Disk, Disks
from mitsuba_ref.error_model.defect_conditions import (
    GRAZED_FLAT,
    STARTS_ON_FLAT,
    DefectView,
    KnownDefect,
    abs_cosine,
    far_from_origin,
)
from mitsuba_ref.error_model.independent_transform import ExpectedNumbers, up_to_rounding
from mitsuba_ref.error_model.intersections import (
    Array,
    ErrorModel,
    Intersections,
    UvSpace,
    by_normal,
    norm,
    position_error,
    without_edges,
    without_float_warnings,
)
from mitsuba_ref.oracle.exact_kinds import DISKS as EXACT_DISKS
from mitsuba_ref.shapes.shape_reference import PrimitiveReference, ShapeReference, describe_unit_shape
from mitsuba_ref.shapes.surface_errors import (
    TURN,
    RayTransform,
    on_circle,
    on_plane,
    ours_through_object_space,
    rays_in_object_space,
    world_normal,
)
from mitsuba_ref.shapes.targets import (
    Rng,
    SurfacePoints,
    on_unit_shape,
    pushed_outside,
    random_fractions,
    unit_circle_points,
)


@without_float_warnings
def intersect(
    prims: Any, k: Array, o: Array, d: Array, ku: float, transformed: RayTransform = rays_in_object_space
) -> tuple[Intersections, ...]:
    """Intersections of ray i with disk k[i]: the plane z = 0 of object space, then the rim."""
    to_object = prims.to_object[k]
    rays = transformed(prims.center[k], to_object, o, d)
    t = -rays.o[:, 2] / rays.d[:, 2]
    components, slope = rays.components(t), np.abs(rays.d[:, 2])
    rho = ku * rays.rows[:, 2] * rays.d_size / slope
    settled, t_error, resolvable = on_plane(t, components[:, 2], slope, rho, ku)
    q = rays.o + t[:, None] * rays.d
    rim = np.hypot(q[:, 0], q[:, 1])
    rim_error = ku * (components[:, 0] + components[:, 1]) + t_error * norm(rays.d[:, :2])
    possible, certain = ~(rim - 1.0 > rim_error), (1.0 - rim > rim_error) & resolvable
    up = np.tile([0.0, 0.0, 1.0], (len(k), 1))
    n, n_error = world_normal(to_object, up, np.zeros(len(k)), ku)
    p_error = position_error(o, d, settled, t_error, ku)
    uv = np.where(np.isfinite(q), q, 0.0) * np.array([1.0, 1.0, 0.0])
    uv_error = rim_error + TURN * ku * rim
    return (without_edges(settled, t_error, n, n_error, possible, certain, p_error, uv, uv_error),)


def uv_points(_prims: Any, _k: Array, uv: Array, whole_turn: bool = False) -> Array:
    """Points of the unit disk with u the distance from the centre, v the angle as a fraction of a turn."""
    radius = np.where(uv[:, :1] >= 0.0, uv[:, :1], np.nan)
    return np.column_stack([radius * on_circle(uv[:, 1], whole_turn), np.zeros(len(uv))])


UV = UvSpace(uv_points, partial(uv_points, whole_turn=True))


def expected_disk(shape: Any, part: Any) -> Iterator[ExpectedNumbers]:
    """The matrix of to_world."""
    yield up_to_rounding("center", part.center[0], shape.matrix[:3, 3])
    yield up_to_rounding("to_world", part.to_world[0], shape.matrix[:3, :3])


def unit_disk_points(rng: Rng, count: int, sort: str) -> SurfacePoints:
    c, s = unit_circle_points(rng, count)
    zero = np.zeros(count)
    rim, around = np.column_stack([c, s, zero]), np.column_stack([-s, c, zero])
    share = random_fractions(rng, count) if sort == "inside" else np.ones((count, 1))
    along = np.where(rng.random((count, 1)) < 0.5, around, rim)
    return SurfacePoints(share * pushed_outside(rng, rim, sort), along, np.tile([0.0, 0.0, 1.0], (count, 1)))


DISKS = PrimitiveReference(
    Disks,
    ErrorModel(intersect, EXACT_DISKS, ours_through_object_space(intersect, used=(1.0, 1.0, 0.0)), uv=UV),
    describe_unit_shape("disk"),
    on_unit_shape(unit_disk_points),
    derived=("to_object",),
    rounding_groups=(by_normal,),
    known_defects=(
        STARTS_ON_FLAT,
        KnownDefect(45, "a ray through the rim of a disk, exactly", 8, lambda m: "rim" in m.where, "missed"),
        GRAZED_FLAT,
        KnownDefect(47, "a disk far from the origin", 21, far_from_origin),
    ),
    defect_view=lambda prims, k, o, d, t: DefectView(cosine=abs_cosine(prims.to_object[k][2], d)),
)
REFERENCE = ShapeReference(
    Disk,
    lambda out, shape, part: out.native(shape, "disk", part.center, part.to_world),
    (DISKS,),
    expected_disk,
    groups=("quadric", "flat", "small"),
    analytic=True,
)

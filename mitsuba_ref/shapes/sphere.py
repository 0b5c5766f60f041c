"""Spheres and ellipsoids: Mitsuba's sphere, or an instance of one if stretched, and its `ellipsoids`, which rays meet
from outside only; error models and targets."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from caster.geometry.mesh_files import load_points
from caster.shapes.sphere import EllipsoidCloud, Ellipsoids, OuterEllipsoids, Sphere, SphereCloud, Spheres
from caster.system.atomic_files import write_bytes
from mitsuba_ref.error_model.defect_conditions import (
    FAR_IN_SIZES,
    STARTS_ON_CURVED,
    STRETCHED,
    DefectView,
    KnownDefect,
    small_and_far,
)
from mitsuba_ref.error_model.independent_transform import ExpectedNumbers, expected_points, up_to_rounding
from mitsuba_ref.error_model.intersections import (
    Array,
    ErrorModel,
    Intersections,
    UvSpace,
    by_approach,
    by_columns,
    by_matrix,
    dot,
    mat_vec_rows,
    norm,
    perpendicular,
    position_error,
    without_edges,
)
from mitsuba_ref.error_model.tolerances import SIMILARITY_ROUNDINGS, TRANSFORM_ROUNDINGS
from mitsuba_ref.oracle import exact_kinds
from mitsuba_ref.scene_xml.elements import ShapeWriter, XmlElement, float_columns
from mitsuba_ref.shapes.shape_reference import Fields, PrimitiveReference, ShapeReference, describe_unit_shape
from mitsuba_ref.shapes.surface_errors import (
    SPHERE_UV,
    growth_of_ellipsoids,
    half_chord_error,
    intersect_round,
    ours_through_object_space,
    sphere_roots,
    sphere_uv,
    sphere_uv_points,
)
from mitsuba_ref.shapes.targets import (
    Rng,
    SurfacePoints,
    coin_flip,
    on_unit_shape,
    pushed_outside,
    random_length,
    random_point,
    random_unit_vectors,
    unit_circle_points,
)


def to_xml(out: ShapeWriter, shape: Sphere | SphereCloud, part: Any) -> list[XmlElement]:
    """Centre and radius as one matrix; ellipsoids as instances, as Mitsuba's sphere supports no stretching."""
    if isinstance(part, Ellipsoids):
        return out.instances(shape, "sphere", part)
    return out.native(shape, "sphere", part.center, part.radius[:, None, None] * np.eye(3))


def intersect(prims: Any, k: Array, o: Array, d: Array, ku: float) -> tuple[Intersections, ...]:
    """Intersections of ray i with sphere k[i]: near root, far root."""
    center, r = by_columns(prims.center[k]), prims.radius[k]
    o, d = by_columns(o), by_columns(d)
    middle, distance, s = sphere_roots(o - center, d, r)
    size, found = norm(d), []
    for side in (-1.0, 1.0):
        t = middle + side * s / size
        n = (o - center + t[:, None] * d) / np.maximum(distance, r)[:, None]
        reach = np.abs(o) + np.abs(t)[:, None] * np.abs(d) + np.abs(center)
        error = ku * (dot(np.abs(n), reach) + r)
        t_error = half_chord_error(s, r, error) / size + ku * np.abs(t)
        slide = np.sqrt(np.maximum(size * size - dot(n, d) ** 2, 0.0))
        n_error = (ku * norm(reach) + slide * t_error) / r + 0.5 * ku
        possible, certain = distance - r <= error, r - distance > error
        p_error = position_error(o, d, t, t_error, ku)
        uv, uv_error = sphere_uv(mat_vec_rows(prims.turn[k], n), n_error + TURN_ERROR * ku, ku)
        found.append(without_edges(t, t_error, n, n_error, possible, certain, p_error, uv, uv_error))
    return tuple(found)


# Multiplying by a matrix with rounded entries moves each coordinate by ku |row| |n| = ku.
TURN_ERROR = math.sqrt(3.0)


intersect_ellipsoid = partial(intersect_round, ends=False)


def describe_spheres(part: Spheres, file: Path) -> Fields:
    """A cloud of spheres of float32 numbers, from a binary PLY file."""
    x, y, z = part.center.T
    write_bytes(file, float_columns({"x": x, "y": y, "z": z, "radius": part.radius}))
    return {"type": "spheres", "file": str(file)}


def expected_spheres(shape: Any, part: Any) -> Iterator[ExpectedNumbers]:
    """The numbers expected of spheres (centres, radii, rotations) or ellipsoids (centres, matrices).

    Those of a cloud's file are taken from our own reader.
    """
    if isinstance(shape, Sphere):
        centers, radii = np.array([shape.center]), np.array([shape.radius])
    else:
        centers, radii_given = (np.array(shape.centers), shape.radii) if shape.file is None else load_points(shape.file)
        radii = np.full(len(centers), shape.radius or 1.0) if radii_given is None else np.array(radii_given)
    linear = shape.matrix[:3, :3]
    yield expected_points(shape, "center", part.center, centers)
    if hasattr(part, "radius"):
        yield from similarity_numbers(linear, radii, part)
    else:
        yield up_to_rounding("to_world", part.to_world, np.einsum("k,ij->kij", radii, linear))


def similarity_numbers(linear: Array, radii: Array, part: Any) -> Iterator[ExpectedNumbers]:
    """Radii and rotations of spheres under a similarity.

    The scale is the cube root of the determinant. Of a matrix that is a similarity only up to rounding, this is the
    factor of lengths to first order.
    """
    largest = np.abs(linear).max()
    scale = largest * np.cbrt(abs(np.linalg.det(linear / largest)))
    radius = radii * scale
    yield ExpectedNumbers("radius", part.radius, radius, radius)
    columns = linear / scale
    size = np.full((3, 3), SIMILARITY_ROUNDINGS / TRANSFORM_ROUNDINGS)
    yield ExpectedNumbers("similarity", columns.T @ columns, np.eye(3), size)
    turns = np.tile(np.swapaxes(columns, 0, 1), (len(radii), 1, 1))
    yield ExpectedNumbers("turn", part.turn, turns, np.ones((1, 3, 3)))


def on_spheres(prims: Any, k: Array, rng: Rng, sort: str) -> SurfacePoints:
    p, along, n = unit_sphere_points(rng, len(k), sort)
    r = prims.radius[k][:, None]
    return SurfacePoints(prims.center[k] + r * p, r * along, n)


def unit_sphere_points(rng: Rng, count: int, sort: str) -> SurfacePoints:
    c, s = unit_circle_points(rng, count)
    turned = rng.permuted(np.column_stack([c, s, np.zeros(count)]), axis=1)
    any_way = random_unit_vectors(rng, count)
    u = np.where((sort == "corner") | (rng.random((count, 1)) < 0.3), turned, any_way)
    return SurfacePoints(pushed_outside(rng, u, sort), perpendicular(u), u)


def random_cloud(rng: Rng, lattice: bool) -> Fields:
    """One to eight spheres, with one radius each or a common one."""
    count = int(rng.integers(1, 9))
    centers = [random_point(rng, lattice) for _ in range(count)]
    if coin_flip(rng):
        return {"centers": centers, "radius": random_length(rng, lattice)}
    return {"centers": centers, "radii": [random_length(rng, lattice) for _ in range(count)]}


DEFECTS = (
    STARTS_ON_CURVED,
    KnownDefect(
        4,
        "a sphere that a ray touches in one point, exactly: Mitsuba misses it",
        5,
        lambda m: "tangent" in m.where,
        "missed",
    ),
    KnownDefect(2, "a sphere that is small and far away", 17, small_and_far),
    KnownDefect(
        9,
        "a sphere far from the origin; one so far that it is lost in the rounding of its centre has no normal there",
        19,
        lambda m: m.offset > FAR_IN_SIZES and (m.nearly or m.normless),
    ),
)

SPHERES = PrimitiveReference(
    Spheres,
    ErrorModel(
        intersect,
        exact_kinds.SPHERES,
        uv=UvSpace(
            sphere_uv_points,
            # Mitsuba's uv are those of world axes, as its spheres are exported without their rotation.
            lambda prims, k, uv: mat_vec_rows(prims.turn[k], sphere_uv_points(prims, k, uv, whole_turn=True)),
            partial(sphere_uv_points, whole_turn=True),
        ),
    ),
    lambda part, k: {"type": "sphere", "center": part.center[k].tolist(), "radius": float(part.radius[k])},
    on_spheres,
    describe_all=describe_spheres,
    rounding_groups=(by_approach,),
    # float32 throughout, so that the centre relative to the origin is rounded
    rounding_groups_llvm=(lambda prims, k, **_: prims.center[k],),
    known_defects=DEFECTS,
)
ELLIPSOIDS = PrimitiveReference(
    Ellipsoids,
    ErrorModel(
        intersect_ellipsoid,
        exact_kinds.ELLIPSOIDS,
        ours_through_object_space(intersect_ellipsoid),
        SPHERE_UV,
        growth_of_ellipsoids,
    ),
    describe_unit_shape("sphere"),
    on_unit_shape(unit_sphere_points),
    derived=("to_object",),
    rounding_groups=(by_matrix,),
    known_defects=(*DEFECTS, STRETCHED),
    defect_view=lambda prims, k, o, d, t: DefectView(stretch=float(np.linalg.norm(prims.to_object[k] @ d))),
)
REFERENCE = ShapeReference(
    Sphere,
    to_xml,
    (SPHERES, ELLIPSOIDS),
    expected_spheres,
    lambda rng, lattice: (
        {"center": random_point(rng, lattice), "radius": random_length(rng, lattice)} if coin_flip(rng) else {}
    ),
    groups=("quadric", "small"),
    analytic=True,
)
CLOUD = replace(REFERENCE, describes=SphereCloud, random_fields=random_cloud, groups=("quadric",))

# Properties of Mitsuba's file; it reads those between nz and scale_0 as an attribute `exact` of the shape.
PROPERTIES = (
    *("x", "y", "z", "nx", "ny", "nz"),
    *(f"exact_{i}" for i in range(7)),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)


def ellipsoids_to_xml(out: ShapeWriter, shape: EllipsoidCloud, part: OuterEllipsoids) -> list[XmlElement]:
    """A PLY file of centres, logarithms of the semi-axes, and quaternions.

    Mitsuba takes the exponential of the logarithms in float32, which rounds. When rays are traced, the numbers `exact`
    replace the result (mitsuba_calls.py).
    """
    turn, radii, _ = np.linalg.svd(part.to_world)
    x, y, z, w = as_quaternions(turn * np.linalg.det(turn)[:, None, None]).T  # mirrored, an ellipsoid is the same
    columns = [*part.center.T, *np.zeros((3, len(radii))), *radii.T, x, y, z, w, *np.log(radii).T, w, x, y, z]
    content = float_columns(dict(zip(PROPERTIES, columns, strict=True)))
    return [out.from_file(shape, "ellipsoids", "ply", content, [Element("float", name="extent", value="1")])]


def as_quaternions(turn: Array) -> Array:
    """(n, 4) unit quaternions x, y, z, w of rotation matrices (n, 3, 3)."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.moveaxis(turn, 0, 2)
    # four times the outer product of the quaternion with itself
    rows = [
        [1.0 + xx - yy - zz, xy + yx, xz + zx, zy - yz],
        [xy + yx, 1.0 - xx + yy - zz, yz + zy, xz - zx],
        [xz + zx, yz + zy, 1.0 - xx - yy + zz, yx - xy],
        [zy - yz, xz - zx, yx - xy, 1.0 + xx + yy + zz],
    ]
    return np.asarray(np.linalg.eigh(np.moveaxis(np.array(rows), 2, 0))[1][:, :, -1])


def enter_ellipsoid(*arguments: Any, float32: bool = True) -> tuple[Intersections, ...]:
    """Where ray i enters ellipsoid k[i]. float32: as Mitsuba computes it."""
    return intersect_round(*arguments, ends=False, float32=float32)[:1]


# A A^T has products of two axes, each off by the roundings of a transform; so has what it is compared with.
SQUARED_AXES = 4.0


def expected_ellipsoids(shape: EllipsoidCloud, part: OuterEllipsoids) -> Iterator[ExpectedNumbers]:
    """Centres, and A A^T, the ellipsoid itself: it is the same for mirrored axes or in another order."""
    centers, scales, quaternions = shape.ellipsoids()
    linear = shape.matrix[:3, :3]
    yield expected_points(shape, "center", part.center, centers)
    unit = quaternions / np.linalg.norm(quaternions, axis=1)[:, None]
    # q p q* of each axis p: p + 2 w (v x p) + 2 v x (v x p)
    v, w = unit[:, None, :3], unit[:, None, 3:]
    once = np.cross(v, np.eye(3))
    axes = (np.eye(3) + 2.0 * (w * once + np.cross(v, once))) * (shape.extent * scales)[:, :, None] @ linear.T
    reach = np.linalg.norm(linear, axis=1) * (shape.extent * scales).max(axis=1)[:, None]
    squares = np.einsum("nki,nkj->nij", axes, axes)
    packed = np.einsum("nik,njk->nij", part.to_world, part.to_world)
    yield ExpectedNumbers("ellipsoid", packed, squares, SQUARED_AXES * reach[:, :, None] * reach[:, None, :])


def random_ellipsoids(rng: Rng, lattice: bool) -> Fields:
    """One to eight ellipsoids; on the lattice turned by quarters of a turn or not at all."""
    count = int(rng.integers(1, 9))
    turns = [[0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 1.0], [0.0, -1.0, 0.0, 1.0]]
    return {
        "centers": [random_point(rng, lattice) for _ in range(count)],
        "scales": [[random_length(rng, lattice) for _ in range(3)] for _ in range(count)],
        "quaternions": [turns[int(rng.integers(3))] if lattice else rng.normal(size=4).tolist() for _ in range(count)],
    }


OUTER_ELLIPSOIDS = replace(
    ELLIPSOIDS,
    arrays=OuterEllipsoids,
    model=ErrorModel(
        enter_ellipsoid,
        exact_kinds.OUTER_ELLIPSOIDS,
        ours_through_object_space(partial(enter_ellipsoid, float32=False)),
        UvSpace(sphere_uv_points, None),
        partial(growth_of_ellipsoids, float32=True),
    ),
    describe=describe_unit_shape("ellipsoids", **EllipsoidCloud.MINIMAL),
)
ELLIPSOID_CLOUD = ShapeReference(
    EllipsoidCloud,
    ellipsoids_to_xml,
    (OUTER_ELLIPSOIDS,),
    expected_ellipsoids,
    random_ellipsoids,
    analytic=True,
    drawn_for="spheres",
)

"""Spheres and ellipsoids: Mitsuba's sphere, or an instance of one if stretched; error model and targets."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from caster.description.transform import is_mirrored, row_lengths, transform_points
from caster.geometry.mesh_files import load_points
from caster.shapes.sphere import Ellipsoids, Sphere, SphereCloud, Spheres
from caster.system.atomic_files import write_bytes
from mitsuba_ref.error_model.defect_conditions import FAR_IN_SIZES, STARTS_ON_CURVED, STRETCHED, DefectView, KnownDefect
from mitsuba_ref.error_model.independent_transform import ExpectedNumbers, expected_point, up_to_rounding
from mitsuba_ref.error_model.intersections import (
    ErrorModel,
    Intersections,
    UvSpace,
    by_approach,
    by_center,
    by_columns,
    by_matrix,
    dot,
    mat_vec_rows,
    norm,
    position_error,
)
from mitsuba_ref.error_model.tolerances import SIMILARITY_ROUNDINGS, TRANSFORM_ROUNDINGS
from mitsuba_ref.oracle.exact_quadrics import ELLIPSOIDS as EXACT_ELLIPSOIDS
from mitsuba_ref.oracle.exact_quadrics import SPHERES as EXACT_SPHERES
from mitsuba_ref.scene_xml.elements import ShapeWriter, XmlElement
from mitsuba_ref.shapes.shape_reference import (
    Fields,
    PrimitiveReference,
    ShapeReference,
    XmlShape,
    to_world_fields,
    unit_shape_matrix,
)
from mitsuba_ref.shapes.surface_errors import (
    SPHERE_UV,
    RayTransform,
    affine_bounds,
    half_chord_error,
    ours_through_object_space,
    rays_in_object_space,
    sphere_roots,
    sphere_uv,
    sphere_uv_points,
    world_normal,
)
from mitsuba_ref.shapes.targets import (
    Rng,
    SurfacePoints,
    UnitPoints,
    coin_flip,
    pushed_outside,
    random_length,
    random_point,
    to_world_points,
    unit_circle_points,
)


def to_xml(out: ShapeWriter, shape: Sphere | SphereCloud, part: Any) -> list[XmlElement]:
    """Centre and radius as one matrix; ellipsoids as instances, as Mitsuba's sphere supports no stretching."""
    if isinstance(part, Ellipsoids):
        return out.instances(shape, "sphere", part)
    return out.native(shape, "sphere", part.center, part.radius[:, None, None] * np.eye(3))


def intersect(prims: Any, k: np.ndarray, o: np.ndarray, d: np.ndarray, ku: float) -> tuple[Intersections, ...]:
    """Intersections of ray i with sphere k[i]: near root, far root."""
    center, r = by_columns(prims.center[k]), prims.radius[k]
    o, d = by_columns(o), by_columns(d)
    middle, distance, s = sphere_roots(o - center, d, r)
    turn = prims.turn[k]
    return tuple(_sphere_root(center, r, turn, o, d, (middle, distance, s), side, ku) for side in (-1.0, 1.0))


def _sphere_root(
    center: np.ndarray,
    r: np.ndarray,
    turn: np.ndarray,
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
    uv, uv_error = sphere_uv(mat_vec_rows(turn, n), n_error + TURN_ERROR * ku, ku)
    return Intersections(t, t_error, n, n_error, n, n_error, possible, certain, p_error, uv, uv_error)


# Multiplying by a matrix with rounded entries moves each coordinate by ku |row| |n| = ku.
TURN_ERROR = math.sqrt(3.0)


def reference_uv_points(prims: Spheres, k: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Mitsuba's uv are those of world axes, as its spheres are exported without their rotation."""
    return mat_vec_rows(prims.turn[k], sphere_uv_points(prims, k, uv, whole_turn=True))


def intersect_ellipsoid(
    prims: Any, k: np.ndarray, o: np.ndarray, d: np.ndarray, ku: float, transformed: RayTransform = rays_in_object_space
) -> tuple[Intersections, ...]:
    """Intersections of ray i with ellipsoid k[i], a unit sphere in object space; transforming the ray is rounded.

    Mitsuba 3.9.1 moves the ray's origin to its closest approach to the centre, to avoid cancellation, but takes the
    distance to that point for its parameter. If d is longer than 1 in object space, it overshoots, and rounds there.
    """
    to_object = prims.to_object[k]
    rays = transformed(prims.center[k], to_object, o, d)
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
        # Mitsuba projects the point onto the unit sphere along its radius, which may be far longer in world space.
        away = error + np.abs(dot(q, rays.d)) * t_error + 0.5 * (slide * t_error) ** 2
        pulled = norm(mat_vec_rows(prims.to_world[k], q)) * away
        p_error = position_error(o, d, t, t_error, ku) + pulled
        uv, uv_error = sphere_uv(q, error + slide * t_error, ku)
        found.append(Intersections(t, t_error, n, n_error, n, n_error, possible, certain, p_error, uv, uv_error))
    return tuple(found)


def sphere_bounds(prims: Spheres) -> tuple[np.ndarray, np.ndarray]:
    r = prims.radius[:, None]
    return prims.center - r, prims.center + r


def describe_sphere(part: Spheres, k: int) -> Fields:
    return {"type": "sphere", "center": part.center[k].tolist(), "radius": float(part.radius[k])}


def describe_spheres(part: Spheres, file: Path) -> Fields:
    """A cloud of spheres from a binary PLY file of float64 centres and radii."""
    points = np.column_stack([part.center, part.radius]).astype("<f8")
    properties = "".join(f"property double {name}\n" for name in ("x", "y", "z", "radius"))
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{properties}end_header\n"
    write_bytes(file, head.encode() + points.tobytes())
    return {"type": "spheres", "file": str(file)}


def describe_ellipsoid(part: Ellipsoids, k: int) -> Fields:
    return {"type": "sphere", "to_world": unit_shape_matrix(part, k)}


def expected_sphere(shape: Any, part: Any) -> Iterator[ExpectedNumbers]:
    """Centre, and radius and rotation or matrix.

    The scale of a similarity is computed from volumes, which it scales by its cube; for a matrix that is a similarity
    only up to rounding, that equals the scale of lengths to first order.
    """
    linear = shape.matrix[:3, :3]
    yield expected_point(shape, "center", part.center[0], np.array(shape.center))
    if hasattr(part, "radius"):
        yield from similarity_numbers(linear, np.array([shape.radius]), part)
    else:
        yield up_to_rounding("to_world", part.to_world[0], shape.radius * linear)


def expected_cloud(shape: Any, part: Any) -> Iterator[ExpectedNumbers]:
    """The same for each sphere of a cloud. The contents of its file are checked elsewhere."""
    centers, radii = (np.array(shape.centers), shape.radii) if shape.file is None else load_points(shape.file)
    radii = np.full(len(centers), shape.radius or 1.0) if radii is None else np.array(radii)
    linear, move = shape.matrix[:3, :3], shape.matrix[:3, 3]
    size = np.abs(centers) @ np.abs(linear).T + np.abs(move)
    yield ExpectedNumbers("center", part.center, centers @ linear.T + move, size)
    if hasattr(part, "radius"):
        yield from similarity_numbers(linear, radii, part)
    else:
        yield up_to_rounding("to_world", part.to_world, np.einsum("k,ij->kij", radii, linear))


def similarity_numbers(linear: np.ndarray, radii: np.ndarray, part: Any) -> Iterator[ExpectedNumbers]:
    """Radii and rotations of spheres under a similarity."""
    largest = np.abs(linear).max()
    scale = largest * np.cbrt(abs(np.linalg.det(linear / largest)))
    radius = radii * scale
    yield ExpectedNumbers("radius", part.radius, radius, radius)
    columns = linear / scale
    size = np.full((3, 3), SIMILARITY_ROUNDINGS / TRANSFORM_ROUNDINGS)
    yield ExpectedNumbers("similarity", columns.T @ columns, np.eye(3), size)
    turns = np.tile(np.swapaxes(columns, 0, 1), (len(radii), 1, 1))
    yield ExpectedNumbers("turn", part.turn, turns, np.ones((1, 3, 3)))


def on_spheres(prims: Any, k: np.ndarray, rng: Rng, sort: str) -> SurfacePoints:
    p, along, n = unit_sphere_points(rng, len(k), sort)
    r = prims.radius[k][:, None]
    return SurfacePoints(prims.center[k] + r * p, r * along, n)


def on_ellipsoids(prims: Any, k: np.ndarray, rng: Rng, sort: str) -> SurfacePoints:
    return to_world_points(prims, k, unit_sphere_points(rng, len(k), sort))


def unit_sphere_points(rng: Rng, count: int, sort: str) -> UnitPoints:
    c, s = unit_circle_points(rng, count)
    turned = rng.permuted(np.column_stack([c, s, np.zeros(count)]), axis=1)
    any_way = rng.normal(size=(count, 3))
    any_way /= np.linalg.norm(any_way, axis=1, keepdims=True)
    u = np.where((sort == "corner") | (rng.random((count, 1)) < 0.3), turned, any_way)
    across = np.cross(u, np.eye(3)[np.argmin(np.abs(u), axis=1)])
    return pushed_outside(rng, u, sort), across, u


def random_fields(rng: Rng, lattice: bool) -> Fields:
    return {"center": random_point(rng, lattice), "radius": random_length(rng, lattice)} if coin_flip(rng) else {}


def random_cloud(rng: Rng, lattice: bool) -> Fields:
    """One to eight spheres, with one radius each or a common one."""
    count = int(rng.integers(1, 9))
    centers = [random_point(rng, lattice) for _ in range(count)]
    if coin_flip(rng):
        return {"centers": centers, "radius": random_length(rng, lattice)}
    return {"centers": centers, "radii": [random_length(rng, lattice) for _ in range(count)]}


def view_ellipsoid(prims: Any, k: int, o: np.ndarray, d: np.ndarray, t: float) -> DefectView:
    return DefectView(stretch=float(np.linalg.norm(prims.to_object[k] @ d)))


def numbers_of_sphere(part: Spheres, k: int) -> list[np.ndarray]:
    """All numbers but the rotation, which only uv depend on."""
    return [part.center[k], part.radius[k]]


# The columns of a sphere's matrix have equal lengths up to float32 rounding.
UNIFORM_SCALE_RTOL = 8 * 2.0**-24


def import_sphere(xml: XmlShape) -> Fields:
    """A sphere. Mitsuba applies its matrix to centre and radius only, unless an instance scales it non-uniformly."""
    center, radius = xml.vector("center", (0.0, 0.0, 0.0)), xml.number("radius", 1.0)
    inward = xml.boolean("flip_normals") != (radius < 0.0)
    matrix = xml.matrix
    if matrix is not None and not xml.instanced:  # an instance keeps the orientation of the normal
        inward ^= is_mirrored(matrix[:3, :3])
    if inward:
        xml.note("its normal, which points inwards: normals point outwards here")
    shape = {"type": "sphere", "center": center, "radius": abs(radius)}
    if matrix is None or xml.instanced:
        return shape | to_world_fields(xml)
    sizes = row_lengths(matrix[:3, :3].T)
    if np.ptp(sizes) > UNIFORM_SCALE_RTOL * sizes.max():
        xml.note("the non-uniform scale, which Mitsuba ignores as well: the radius is that along x")
    center = transform_points(matrix, np.array([center]))[0]
    return {"type": "sphere", "center": center.tolist(), "radius": float(abs(radius) * sizes[0])}


TANGENT = KnownDefect(
    4,
    "a sphere that a ray touches in one point, exactly: Mitsuba misses it",
    5,
    "hit",
    lambda m: m.missed and "tangent" in m.where,
)
SMALL_AND_FAR = KnownDefect(
    2, "a sphere that is small and far away", 17, "either", lambda m: m.distance > FAR_IN_SIZES and m.nearly
)
FAR_FROM_ORIGIN = KnownDefect(
    9,
    "a sphere far from the origin; one so far that it is lost in the rounding of its centre has no normal there",
    19,
    "either",
    lambda m: m.offset > FAR_IN_SIZES and (m.nearly or m.normless),
)
DEFECTS = (STARTS_ON_CURVED, TANGENT, SMALL_AND_FAR, FAR_FROM_ORIGIN)

SPHERES = PrimitiveReference(
    Spheres,
    ErrorModel(intersect, sphere_bounds, exact=EXACT_SPHERES, uv=UvSpace(sphere_uv_points, reference_uv_points)),
    describe_sphere,
    on_spheres,
    describe_all=describe_spheres,
    numbers=numbers_of_sphere,
    rounding_groups=(by_approach,),
    rounding_groups_llvm=(by_center,),
    known_defects=DEFECTS,
)
ELLIPSOIDS = PrimitiveReference(
    Ellipsoids,
    ErrorModel(
        intersect_ellipsoid,
        affine_bounds,
        ours_through_object_space(intersect_ellipsoid),
        exact=EXACT_ELLIPSOIDS,
        uv=SPHERE_UV,
    ),
    describe_ellipsoid,
    on_ellipsoids,
    derived=("to_object",),
    rounding_groups=(by_matrix,),
    known_defects=(*DEFECTS, STRETCHED),
    defect_view=view_ellipsoid,
)
CLOUD = ShapeReference(
    SphereCloud,
    to_xml,
    (SPHERES, ELLIPSOIDS),
    expected_cloud,
    random_cloud,
    groups=frozenset({"quadric"}),
    analytic=True,
)
REFERENCE = ShapeReference(
    Sphere,
    to_xml,
    (SPHERES, ELLIPSOIDS),
    expected_sphere,
    random_fields,
    groups=frozenset({"quadric", "small"}),
    analytic=True,
    importers={"sphere": import_sphere},
)

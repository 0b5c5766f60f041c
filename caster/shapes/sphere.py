"""Spheres, one or many; with a non-uniform to_world, ellipsoids; and ellipsoids that are met from outside only."""

from collections.abc import Mapping
from inspect import unwrap
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import model_validator

from caster.description.fields import (
    Flag,
    Lengths,
    LengthTriples,
    Points,
    Positive,
    Quaternions,
    Shape,
    Vec3,
    exactly_one,
)
from caster.description.transform import inverse, rotations, transform_points, transform_vectors
from caster.geometry.mesh_files import load_once, load_points, readable
from caster.geometry.world_space import AffineImages, Rounding, largest_curvature, similarity_scale
from caster.jit.decorators import implement, inlined
from caster.kernels.exact.numbers import Root
from caster.kernels.exact.primitives import (
    exact_quadric_roots,
    exact_sphere,
    exact_unit_sphere,
    ray_in_object_space,
    root_in_range,
)
from caster.kernels.math.angles import polar_fraction, turn_fraction
from caster.kernels.math.quadric_roots import (
    closest_approach,
    fast_outward_normal,
    first_root,
    outward_normal,
    quadric_roots,
    quadric_setup,
)
from caster.kernels.math.vec import (
    TO_OBJECT_SPACE_ERROR,
    U,
    add,
    certain_in_range,
    cube_corner,
    fast_normalize,
    fast_unit_direction,
    filter_result,
    l1_norm,
    mat_vec,
    matrix_rows,
    normalize,
    point_at,
    row,
    row_max_norms,
    rows_times_vec,
    sub,
    to_object_space,
    transposed_mat_vec,
    transposed_rows_times_vec,
    unit_direction,
)
from caster.kernels.protocol import (
    exact_intersect,
    fast_surface,
    fast_uv,
    hull_point,
    intersect,
    load,
    prepare,
    surely_misses,
    surface,
    surface_setup,
    tight_sphere,
)
from caster.kernels.raster.tile import (
    LANE_CENTER,
    LANE_SETUP,
    LANE_TO_OBJECT,
    LANE_TO_WORLD,
    NEXT,
    SURFACE_LANES,
    SURFACES_WITH_UV,
    get_lane,
    get_matrix,
    lane,
    put_affine_lanes,
    put_lane,
    put_matrix,
)

__all__ = ["EllipsoidCloud", "Ellipsoids", "OuterEllipsoids", "Sphere", "SphereCloud", "Spheres"]


class Spheres(NamedTuple):
    """Spheres in world space."""

    center: np.ndarray  # (n, 3) float64
    radius: np.ndarray  # (n,) float64
    turn: np.ndarray  # (n, 3, 3) float64, rotation from world to object space, for uv

    @property
    def curvature(self) -> np.ndarray:
        """(n,), 1 / radius."""
        return 1.0 / self.radius


class Ellipsoids(AffineImages):
    """Images of the unit sphere at the origin."""

    curvature = property(largest_curvature)


class OuterEllipsoids(Ellipsoids):
    """The same, met where a ray enters them only: one that starts inside passes through."""


class Sphere(Shape):
    """All points at distance `radius` from `center`.

    The normal points outwards, under mirroring transforms as well; inwards with `flip_normals`.
    """

    type: Literal["sphere"] = "sphere"
    center: Vec3 = (0.0, 0.0, 0.0)  # scene units
    radius: Positive = 1.0  # scene units
    flip_normals: Flag = False

    def pack(self, rounded: Rounding) -> Spheres | Ellipsoids:
        return pack_spheres(np.array([self.center]), np.array([self.radius]), self.matrix, rounded)


class SphereCloud(Shape):
    """Many spheres as one shape: the vertices of a PLY file and their property `radius`, or `centers` and `radii`.

    `radius` is for all spheres, 1 by default, if they have no radii of their own. Primitives are numbered in the order
    of the list.
    """

    type: Literal["spheres"] = "spheres"
    MINIMAL: ClassVar[Mapping[str, Any]] = {"centers": ((0.0, 0.0, 0.0),)}
    centers: Points | None = None  # scene units
    radii: Lengths | None = None  # scene units
    radius: Positive | None = None  # scene units
    file: Annotated[str | None, readable(load_points)] = None

    _has_one_source = exactly_one("file", "centers")

    @model_validator(mode="after")
    def _has_radii_once(self) -> "SphereCloud":
        count = 0 if self.centers is None else len(self.centers)
        if self.radii is not None and len(self.radii) != count:
            raise ValueError(f"needs as many radii as centers, got {len(self.radii)} radii and {count} centers")
        if self.radius is not None and self._given()[1] is not None:
            raise ValueError("needs either radius or radii, its own or its file's, got both")
        return self

    def _given(self) -> tuple[np.ndarray, Any]:
        """Centres and radii, or None, of the lists or of the file."""
        return (np.array(self.centers), self.radii) if self.file is None else load_once(load_points, self.file)

    def spheres(self) -> tuple[np.ndarray, np.ndarray]:
        """Centres (n, 3) and radii (n,) in object space. Raises SceneError, FileMissing for a file."""
        centers, radii = self._given()
        return centers, np.full(len(centers), self.radius or 1.0) if radii is None else np.array(radii)

    def pack(self, rounded: Rounding) -> Spheres | Ellipsoids:
        return pack_spheres(*self.spheres(), self.matrix, rounded)


def pack_spheres(centers: np.ndarray, radii: np.ndarray, matrix: np.ndarray, rounded: Rounding) -> Spheres | Ellipsoids:
    """Spheres with centers (n, 3) and radii (n,) under a matrix (4, 4), as arrays in world space."""
    linear = matrix[:3, :3]
    moved = rounded(transform_points(matrix, centers))
    scale = similarity_scale(linear)
    if scale is None:
        to_world = rounded(radii[:, None, None] * linear)
        _, first, same = np.unique(radii, return_index=True, return_inverse=True)  # an exact inverse takes 20 us
        return Ellipsoids(moved, to_world, np.stack([inverse(to_world[i]) for i in first])[same])
    turn = np.broadcast_to(rounded(linear.T / scale), (len(centers), 3, 3))
    return Spheres(moved, rounded(scale * radii), np.ascontiguousarray(turn))


class EllipsoidCloud(Shape):
    """Many ellipsoids as one shape, visible from outside only: `centers`, `scales` and `quaternions`.

    Semi-axes are `extent` times `scales`; quaternions [x, y, z, w] of any length rotate them. Primitives are numbered
    in the order of the lists.
    """

    type: Literal["ellipsoids"] = "ellipsoids"
    MINIMAL: ClassVar[Mapping[str, Any]] = {
        "centers": ((0.0, 0.0, 0.0),),
        "scales": ((1.0, 1.0, 1.0),),
        "quaternions": ((0.0, 0.0, 0.0, 1.0),),
    }
    centers: Points
    scales: LengthTriples
    quaternions: Quaternions
    extent: Positive = 1.0

    @model_validator(mode="after")
    def _has_all_of_each(self) -> "EllipsoidCloud":
        counts = len(self.centers), len(self.scales), len(self.quaternions)
        if len({*counts}) != 1:
            expected = "needs as many centers as scales and quaternions"
            raise ValueError("{}, got {} centers, {} scales, {} quaternions".format(expected, *counts))
        turned = self.quaternions.any(axis=1)
        if not turned.all():
            raise ValueError(f"needs quaternions other than 0, got 0 as number {int(np.argmin(turned))}")
        return self

    def ellipsoids(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Centres (n, 3), scales (n, 3) and quaternions (n, 4) in object space."""
        return np.array(self.centers), np.array(self.scales), np.array(self.quaternions)

    def pack(self, rounded: Rounding) -> OuterEllipsoids:
        centers, scales, quaternions = self.ellipsoids()
        axes = np.moveaxis(rotations(quaternions) * (self.extent * scales)[:, None, :], 2, 0)
        to_world = rounded(np.stack([transform_vectors(self.matrix[:3, :3], axis) for axis in axes], axis=2))
        center = rounded(transform_points(self.matrix, centers))
        return OuterEllipsoids(center, to_world, np.stack([*map(inverse, to_world)]))


@inlined
def spherical_uv(q: Any) -> tuple[float, float]:
    """uv of a point of the unit sphere: azimuth as a fraction of a turn, polar angle over pi."""
    return turn_fraction(q[1], q[0]), polar_fraction(min(max(q[2], -1.0), 1.0))


@implement(load, Spheres)
@implement(tight_sphere, Spheres)
def _center_and_radius(prims: Any, k: int) -> Any:
    return row(prims.center, k), prims.radius[k]


@implement(prepare, Spheres)
def _prepare(prims: Any, prim: Any, o: Any) -> Any:
    center, r = prim
    f = sub(o, center)
    return quadric_setup(f, r, U * l1_norm(f))


@implement(intersect, Spheres)
def _intersect(prims: Any, pre: Any, d: Any, t_min: float, t_max: float) -> tuple[float, float]:
    return first_root(quadric_roots(pre, d, 0.0), t_min, t_max)


@implement(surely_misses, Spheres)
def _surely_misses(prims: Any, pre: Any, d: Any) -> bool:
    return closest_approach(pre, d, 0.0).missed


@implement(exact_intersect, Spheres)
def _exact_intersect(prims: Any, k: int, o: Any, d: Any, t_min: float, t_max: float) -> Root:
    return exact_sphere(row(prims.center, k), prims.radius[k], o, d, t_min, t_max)


@implement(surface, Spheres)
def _surface(prims: Any, k: int, o: Any, d: Any, t: float, wants_uv: bool) -> Any:
    center, r = load(prims, k)
    n = outward_normal(sub(o, center), d, unit_direction(d), t, r)
    u, v = spherical_uv(mat_vec(prims.turn, k, n)) if wants_uv else (0.0, 0.0)
    return point_at(center, r, n), n, n, u, v


LANE_RADIUS = LANE_SETUP + lane(3 * SURFACE_LANES)
LANE_TURN = LANE_RADIUS + NEXT


@implement(surface_setup, Spheres)
def _surface_setup(prims: Any, k: int, start: Any, stop: Any, scratch: Any, wants: int) -> None:
    center, r = load(prims, k)
    for x in range(start, stop):
        put_lane(scratch, LANE_CENTER + x, center)
        scratch[LANE_RADIUS + x] = r
    if wants == SURFACES_WITH_UV:
        put_matrix(scratch, LANE_TURN, prims.turn, k, start, stop)


@implement(fast_surface, Spheres)
def _fast_surface(prims: Any, scratch: Any, x: Any, o: Any, d: Any, t: float) -> Any:
    center, r = get_lane(scratch, LANE_CENTER + x), scratch[LANE_RADIUS + x]
    known, n = fast_outward_normal(sub(o, center), d, fast_unit_direction(d), t, r)
    return known, known, point_at(center, r, n), n, n, n


@implement(fast_uv, Spheres)
def _fast_uv(prims: Any, scratch: Any, x: Any, n: Any) -> Any:
    return spherical_uv(rows_times_vec(get_matrix(scratch, LANE_TURN + x), n))


@implement(hull_point, Spheres)
def _hull_point(prims: Any, k: int, j: int) -> Any:
    return point_at(row(prims.center, k), prims.radius[k], cube_corner(j))


@implement(load, Ellipsoids, OuterEllipsoids)
def _load_ellipsoid(prims: Any, k: int) -> Any:
    m = matrix_rows(prims.to_object, k)
    return row(prims.center, k), m, TO_OBJECT_SPACE_ERROR * l1_norm(row_max_norms(m))


@implement(prepare, Ellipsoids, OuterEllipsoids)
def _prepare_ellipsoid(prims: Any, prim: Any, o: Any) -> Any:
    """(to_object, QuadricSetup of the unit sphere, error of d in object space per l1 norm)."""
    center, m, d_error = prim
    f, error = to_object_space(m, sub(o, center))
    return m, quadric_setup(f, 1.0, l1_norm(error)), d_error


@implement(intersect, Ellipsoids)
def _intersect_ellipsoid(prims: Any, pre: Any, d: Any, t_min: float, t_max: float) -> tuple[float, float]:
    m, setup, d_error = pre
    return first_root(quadric_roots(setup, rows_times_vec(m, d), d_error * l1_norm(d)), t_min, t_max)


@implement(intersect, OuterEllipsoids)
def _intersect_outer(prims: Any, pre: Any, d: Any, t_min: float, t_max: float) -> tuple[float, float]:
    m, setup, d_error = pre
    roots = quadric_roots(setup, rows_times_vec(m, d), d_error * l1_norm(d))
    return filter_result(roots.met, roots.missed, *certain_in_range(roots.near, roots.near_error, t_min, t_max))


@implement(surely_misses, Ellipsoids, OuterEllipsoids)
def _surely_misses_ellipsoid(prims: Any, pre: Any, d: Any) -> bool:
    m, setup, d_error = pre
    return closest_approach(setup, rows_times_vec(m, d), d_error * l1_norm(d)).missed


@implement(exact_intersect, Ellipsoids)
def _exact_intersect_ellipsoid(prims: Any, k: int, o: Any, d: Any, t_min: float, t_max: float) -> Root:
    return exact_unit_sphere(*ray_in_object_space(row(prims.center, k), prims.to_world[k], o, d), t_min, t_max)


@implement(exact_intersect, OuterEllipsoids)
def _exact_intersect_outer(prims: Any, k: int, o: Any, d: Any, t_min: float, t_max: float) -> Root:
    roots = exact_quadric_roots(*ray_in_object_space(row(prims.center, k), prims.to_world[k], o, d))
    return root_in_range(roots[0], t_min, t_max)


@implement(surface, Ellipsoids, OuterEllipsoids)
def _surface_ellipsoid(prims: Any, k: int, o: Any, d: Any, t: float, wants_uv: bool) -> Any:
    center = row(prims.center, k)
    f = mat_vec(prims.to_object, k, sub(o, center))
    e = mat_vec(prims.to_object, k, d)
    q = outward_normal(f, e, normalize(e), t, 1.0)
    n = normalize(transposed_mat_vec(prims.to_object, k, q))
    u, v = spherical_uv(q) if wants_uv else (0.0, 0.0)
    return add(center, mat_vec(prims.to_world, k, q)), n, n, u, v


implement(surface_setup, Ellipsoids, OuterEllipsoids)(unwrap(put_affine_lanes))


@implement(fast_surface, Ellipsoids, OuterEllipsoids)
def _fast_ellipsoid_surface(prims: Any, scratch: Any, x: Any, o: Any, d: Any, t: float) -> Any:
    center, m = get_lane(scratch, LANE_CENTER + x), get_matrix(scratch, LANE_TO_OBJECT + x)
    e = rows_times_vec(m, d)
    known, q = fast_outward_normal(rows_times_vec(m, sub(o, center)), e, fast_normalize(e), t, 1.0)
    long, n = fast_normalize(transposed_rows_times_vec(m, q))
    p = add(center, rows_times_vec(get_matrix(scratch, LANE_TO_WORLD + x), q))
    return known & long, known & long, p, n, n, q


@implement(fast_uv, Ellipsoids, OuterEllipsoids)
def _fast_ellipsoid_uv(prims: Any, scratch: Any, x: Any, q: Any) -> Any:
    return spherical_uv(q)


@implement(hull_point, Ellipsoids, OuterEllipsoids)
def _hull_point_ellipsoid(prims: Any, k: int, j: int) -> Any:
    return add(row(prims.center, k), mat_vec(prims.to_world, k, cube_corner(j)))

"""Plane: Mitsuba has none, and gets a patch of triangles around the hits of the rays instead.

A single large rectangle would be inaccurate: rounded float32 corners tilt it, the more the larger it is, and nearby
hits would have the errors of hits at the horizon. The patch is a square with rings of trapezoids around it, each twice
as large, so that the corners around a hit are about as far away as the hit itself.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from caster.description.transform import dot_rows, product, row_lengths, sine_and_cosine
from caster.geometry.packing import Triangles
from caster.shapes.plane import Plane, Planes
from mitsuba_ref.error_model.defect_conditions import GRAZED_FLAT, STARTS_ON_FLAT, DefectView, abs_cosine
from mitsuba_ref.error_model.independent_transform import ExpectedNumbers, expected_points, transformed_normals
from mitsuba_ref.error_model.intersections import (
    Array,
    ErrorModel,
    Intersections,
    UvSpace,
    by_normal,
    ceil_log2,
    dot,
    finite_or_zero,
    norm,
    perpendicular,
    position_error,
    rounded,
    triangle_heights,
    unit,
    without_edges,
    without_float_warnings,
)
from mitsuba_ref.oracle.exact_kinds import PLANES as EXACT_PLANES
from mitsuba_ref.scene_xml.elements import ShapeWriter, XmlElement
from mitsuba_ref.shapes import surface_errors
from mitsuba_ref.shapes.shape_reference import Fields, PrimitiveReference, ShapeReference, unit_vector_rounding_to
from mitsuba_ref.shapes.targets import Rng, SurfacePoints, coin_flip, random_directions, random_fractions, random_point

PATCH_RINGS = 24  # up to 2^24 times the square: farther out, float32 does not separate hits from the horizon
LARGEST_PATCH_COORDINATE = 1e10  # Embree's triangles are accurate up to about here (docs/method.md, "Domain")
SQUARE_CORNERS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
PATCH_ROTATION = 0.6  # radians; avoids edges along rows and columns of pixels


class Patches(NamedTuple):
    """Planes, with a patch of triangles as the stand-in for each."""

    normal: Array  # (n, 3) unit
    point: Array  # (n, 3)
    center: Array  # (n, 3) of the patch, in the plane
    axes: Array  # (n, 2, 3) unit, in the plane, orthogonal
    half: Array  # (n,) half the side of the innermost square
    corners: Array  # (n, 4 * (PATCH_RINGS + 1), 3) float32 values, ring by ring from the inside out


def patches(part: Planes, o: Array, d: Array) -> Patches:
    """A patch for each plane, around its hits by the rays."""
    rows = [_patch(normal, point, o, d) for normal, point in zip(part.normal, part.point, strict=True)]
    return Patches(*(np.stack(column) for column in zip(*rows, strict=True)))


def _patch(normal: Array, point: Array, o: Array, d: Array) -> tuple[Array, ...]:
    n = normal / row_lengths(normal[None])
    eye = o.mean(axis=0) if len(o) else point
    center = eye - n * dot_rows(n[None], eye - point)
    (first,) = perpendicular(n[None])
    first = first / row_lengths(first[None])
    second = np.cross(n, first)
    sine, cosine = sine_and_cosine(PATCH_ROTATION)
    turned = cosine * first + sine * second
    axes = np.stack([turned, np.cross(n, turned)])
    half = _half_side(n, point, center, o, d)
    sizes = half * 2.0 ** np.arange(PATCH_RINGS + 1)
    corners = center + (sizes[:, None, None] * product(SQUARE_CORNERS, axes)).reshape(-1, 3)
    return n, point, center, axes, np.array(half), rounded(corners)


# The square of this, an area, is still a normal float32 number.
SMALLEST_HALF_SIDE = 2.0**-60


@without_float_warnings
def _half_side(n: Array, point: Array, center: Array, o: Array, d: Array) -> float:
    """Half the side of the square: the distance within which the nearest tenth of all hits lie."""
    t = dot_rows(point - o, n) / dot_rows(d, n)
    met = np.isfinite(t) & (t > 0.0)
    away = norm(o[met] + t[met, None] * d[met] - center)
    size = float(np.quantile(away, 0.1)) if len(away) else 1.0
    size = max(size, float(np.abs(center).max()) * 2.0**-20, SMALLEST_HALF_SIDE)
    return min(
        size, LARGEST_PATCH_COORDINATE / 4.0 * 2.0**-PATCH_RINGS
    )  # or the outer rings would have no area, which Embree may hit


def faces() -> Array:
    """The triangles of a patch: the square, then ring by ring."""
    square = [[0, 1, 2], [0, 2, 3]]
    rings = []
    for start in range(0, 4 * PATCH_RINGS, 4):
        for side in range(4):
            a, b = start + side, start + (side + 1) % 4
            rings += [[a, a + 4, b + 4], [a, b + 4, b]]
    return np.array(square + rings, np.int32)


PATCH_FACES = faces()


def as_triangles(patch: Patches) -> Triangles:
    """All patches as one mesh; the faces of patch i start at i * len(PATCH_FACES)."""
    count = patch.corners.shape[1]
    shifts = count * np.arange(len(patch.corners), dtype=np.int32)
    every = (PATCH_FACES[None] + shifts[:, None, None]).reshape(-1, 3)
    vertices = patch.corners.reshape(-1, 3)
    flat = np.zeros(len(every), bool)
    return Triangles(vertices, every, np.zeros_like(vertices), np.zeros((len(vertices), 2)), flat, flat)


def to_xml(out: ShapeWriter, shape: Plane, part: Patches) -> list[XmlElement]:
    out.notes.append(f"{out.name}: a patch of triangles stands in for the infinite plane")
    return [out.mesh(shape, as_triangles(part))]


@without_float_warnings
def intersect(prims: Patches, k: Array, o: Array, d: Array, ku: float) -> tuple[Intersections, ...]:
    """Intersections of ray i with plane k[i], with the bound of the triangle hit, and the rounding of its corners.

    Hits beyond the patch have no bound, as the reference hits nothing there. A hit is certain if it is for one of the
    two triangles there, or in doubt at one edge only, which the other or a neighbour shares.
    """
    n, slope = prims.normal[k], dot(prims.normal[k], d)
    t = dot(n, prims.point[k] - o) / slope
    face, within = _face_of_hit(prims, k, o, d, t)
    mesh = as_triangles(prims)
    first, second = (k * len(PATCH_FACES) + face + j for j in (0, 1))
    (local,), (other,) = (surface_errors.intersect(mesh, each, o, d, ku) for each in (first, second))
    corners, others = (mesh.vertices[mesh.faces[each]] for each in (first, second))
    moved = 0.25 * ku * dot(np.abs(n), np.abs(corners).max(axis=1))  # a single rounding: ku / K
    within_one = local.certain | other.certain
    met = np.minimum(triangle_heights(corners), triangle_heights(others))
    # Else the smallest height of the triangles around the ring of `face`: that of the narrow ones in the ring inside
    # it, whose area is h^2 and longest edge sqrt(10) h.
    inside = np.maximum(np.where(face == 0, 0, (face - 2) // 8 + 1) - 2, 0)
    height = np.where(within_one, met, prims.half[k] * 2.0**inside * 2.0 / np.sqrt(10.0))
    t_error = local.t_error + 2.0 * moved / np.abs(slope)  # 2 = 1 / (1 - UNRESOLVABLE)
    n_error = np.maximum(local.n_error, other.n_error) + 2.0 * moved / height
    n_error = np.where(np.isnan(n_error), np.inf, n_error)  # corners that coincide in float32
    resolved = within & np.isfinite(t_error) & np.isfinite(t)
    t_error = np.where(resolved, t_error, np.inf)
    sure = resolved & (within_one | (local.side != 0.0) | (other.side != 0.0))
    t, everywhere = finite_or_zero(t, t_error), np.ones(len(k), bool)
    p_error = local.p_error + position_error(o, d, t, t_error, ku)
    return (without_edges(t, t_error, n, n_error, everywhere, sure, p_error, local.uv, local.uv_error),)


# Two unit vectors in the plane are cross products of length >= 1/2: of 3 roundings each, divided by a length of 4
# roundings; in all less than 32 roundings of either, and ku is at least 4 roundings.
AXES_ERROR = 8.0


def _uv(n: Array, q: Array, p_error: Array, ku: float) -> tuple[Array, Array]:
    """uv of q, relative to the plane's point, and their bound.

    The first axis is orthogonal to n and x, or to n and y if |n_x| >= 1/2. If rounding decides which, either may be
    used, and two vectors of length |q| are at most 2 |q| apart.
    """
    side = np.where(np.abs(n[:, :1]) < 0.5, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    right = unit(np.cross(side, n))
    uv = np.column_stack([dot(q, right), dot(q, np.cross(n, right)), np.zeros(len(q))])
    either = np.abs(np.abs(n[:, 0]) - 0.5) <= ku
    return uv, p_error + (AXES_ERROR * ku + np.where(either, 2.0, 0.0)) * norm(q)


@without_float_warnings
def intersect_ours(prims: Patches, k: Array, o: Array, d: Array, ku: float) -> tuple[Intersections, ...]:
    """Intersections of ray i with plane k[i] itself, from two rounded dot products: height and slope."""
    n, point = prims.normal[k], prims.point[k]
    slope = dot(n, d)
    t = dot(n, point - o) / slope
    rho = np.where(np.isfinite(t), ku * dot(np.abs(n), np.abs(d)) / np.abs(slope), np.inf)
    reach = np.abs(point) + np.abs(o) + np.abs(t)[:, None] * np.abs(d)
    t, t_error, _ = surface_errors.on_plane(t, dot(np.abs(n), reach), np.abs(slope), rho, ku)
    everywhere, flat = np.ones(len(k), bool), np.full(len(k), ku)
    p_error = position_error(o, d, t, t_error, ku)
    certain = np.isfinite(t_error)
    uv, uv_error = _uv(n, o + t[:, None] * d - point, p_error + ku * norm(point), ku)
    return (without_edges(t, t_error, n, flat, everywhere, certain, p_error, uv, uv_error),)


def _face_of_hit(prims: Patches, k: Array, o: Array, d: Array, t: Array) -> tuple[Array, Array]:
    """(first of the two PATCH_FACES of the square or trapezoid around the hit, whether the patch contains the hit)."""
    away = o + np.where(np.isfinite(t), t, 0.0)[:, None] * d - prims.center[k]
    u, v = (dot(away, prims.axes[k, axis]) / prims.half[k] for axis in range(2))
    size = np.maximum(np.abs(u), np.abs(v))
    ring = ceil_log2(np.maximum(size, 1.0))
    side = np.where(np.abs(v) >= np.abs(u), np.where(v > 0, 0, 2), np.where(u > 0, 3, 1))
    within = (ring <= PATCH_RINGS) & (size * prims.half[k] <= LARGEST_PATCH_COORDINATE / 4.0) & np.isfinite(t)
    ring = np.clip(ring, 0, PATCH_RINGS)
    return np.where(ring == 0, 0, 2 + 8 * (ring - 1) + 2 * side), within


def describe_surface(part: Planes, k: int) -> Fields:
    """The packed numbers as they are: the length of the normal does not change the plane."""
    return {"type": "plane", "normal": part.normal[k].tolist(), "point": part.point[k].tolist()}


def expected_plane(shape: Any, part: Any) -> Iterator[ExpectedNumbers]:
    """A point of the plane, and its normal transformed by the matrix of cofactors."""
    point = shape.point if shape.point is not None else np.multiply(shape.offset, shape.normal)
    yield expected_points(shape, "point", part.point, np.array([point]))
    normal, size = transformed_normals(shape.matrix, np.array([shape.normal]))
    yield ExpectedNumbers("normal", part.normal, normal, size)


def on_planes(prims: Any, k: Array, rng: Rng, sort: str) -> SurfacePoints:
    n = prims.normal[k]
    u = perpendicular(n)
    v = np.cross(n, u)
    if sort == "corner":
        return SurfacePoints(prims.point[k], u, n)
    at = random_fractions(rng, len(k)) * u + random_fractions(rng, len(k)) * v
    return SurfacePoints(prims.point[k] + at, np.where(rng.random((len(k), 1)) < 0.5, u, v), n)


def random_fields(rng: Rng, lattice: bool) -> Fields:
    normal = random_directions(rng, 1)[0].tolist()
    if coin_flip(rng):
        return {"normal": normal, "point": random_point(rng, lattice)}
    return {"normal": normal, "offset": random_point(rng, lattice)[0]}


PLANES = PrimitiveReference(
    Planes,
    ErrorModel(intersect, EXACT_PLANES, intersect_ours, uv=UvSpace(reference=None)),
    lambda part, k: describe_surface(part, k) | {"normal": unit_vector_rounding_to(part.normal[k]).tolist()},
    on_planes,
    describe_surface=describe_surface,
    rounding_groups=(by_normal,),
    position_terms=lambda part, k, weights, p: np.abs(p),  # corners of the patch are about as far away as the hit
    known_defects=(STARTS_ON_FLAT, GRAZED_FLAT),
    defect_view=lambda prims, k, o, d, t: DefectView(cosine=abs_cosine(prims.normal[k], d)),
)
REFERENCE = ShapeReference(
    Plane,
    to_xml,
    (PLANES,),
    expected_plane,
    random_fields,
    groups=("flat", "unbounded"),
    stand_in=patches,
    stand_in_note="in place of a plane Mitsuba traces a patch of triangles, which depends on the rays",
)

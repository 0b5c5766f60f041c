"""Triangles, the primitive kind: descriptions, targets and known defects; the error model is in triangle_error.py."""

from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np

from caster.geometry.packing import Triangles
from mitsuba_ref.error_model.defect_conditions import (
    COLLINEAR_HEIGHT_RATIO,
    FAR_IN_SIZES,
    GRAZING_COSINE,
    NEARLY_EDGE_ON_COSINE,
    SLIVER_HEIGHT_RATIO,
    STARTS_ON_FLAT,
    DefectView,
    KnownDefect,
    abs_cosine,
)
from mitsuba_ref.error_model.intersections import KU
from mitsuba_ref.error_model.rounding_groups import by_corner, by_normal
from mitsuba_ref.shapes.descriptions import unit_vector_rounding_to
from mitsuba_ref.shapes.shape_reference import Fields, PrimitiveReference
from mitsuba_ref.shapes.targets import BESIDE_DECADES, Rng, SurfacePoints, random_fractions
from mitsuba_ref.shapes.triangle_error import MODEL


def describe_triangle(part: Triangles, k: int) -> Fields:
    corners = part.faces[k]
    shape: Fields = {"type": "triangle", "vertices": part.vertices[corners].tolist()}
    if part.smooth[k]:
        shape["normals"] = [unit_vector_rounding_to(n).tolist() for n in part.normals[corners]]
    if part.textured[k]:
        shape["uv"] = part.uv[corners].tolist()
    return shape


def on_triangles(prims: Any, k: np.ndarray, rng: Rng, sort: str) -> SurfacePoints:
    corners = prims.vertices[prims.faces[k]]
    corners = np.take_along_axis(
        corners, rng.permuted(np.tile(np.arange(3), (len(k), 1)), axis=1)[..., None], 1
    )
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    share = random_fractions(rng, len(k))
    along = np.where(rng.random((len(k), 1)) < 0.7, b - a, (b - a) + share * (c - a))
    n = np.cross(b - a, c - a)
    if sort == "corner":
        return SurfacePoints(a, along, n)
    if sort == "edge":
        return SurfacePoints(a + share * (b - a), b - a, n)
    if sort == "beside":
        out = 10.0 ** rng.uniform(*BESIDE_DECADES, (len(k), 1))
        return SurfacePoints(a + share * (b - a) - out * (c - a), b - a, n)
    return SurfacePoints(a + 0.5 * share * (b - a) + 0.5 * random_fractions(rng, len(k)) * (c - a), along, n)


def view_triangle(prims: Any, k: int, o: np.ndarray, d: np.ndarray, t: float) -> DefectView:
    corners = prims.vertices[prims.faces[k]]
    edges = np.roll(corners, -1, axis=0) - corners
    longest = float(np.linalg.norm(edges, axis=1).max())
    across = np.cross(edges[0], edges[1])
    area = float(np.linalg.norm(across))
    return DefectView(
        cosine=abs_cosine(across, d),
        slenderness=area / longest**2 if longest > 0.0 else 0.0,
        beyond_corners=_beyond(corners, o, d, t),
        without_area=not has_area(corners),
    )


def _beyond(corners: np.ndarray, o: np.ndarray, d: np.ndarray, t: float) -> bool:
    """Whether t lies outside of what the corners span along the ray, by more than the rounding of it."""
    along = (corners - o) @ d / float(d @ d)
    room = KU * (np.abs(along).max() + abs(t))
    return bool(t > along.max() + room or t < along.min() - room)


def has_area(corners: np.ndarray) -> bool:
    """Whether the triangle has an area, exactly: its edges' cross product in whole numbers."""
    a, b, c = ([Fraction(x) for x in corner] for corner in corners.tolist())
    u, v = ([x - y for x, y in zip(p, a, strict=True)] for p in (b, c))
    return any(u[i] * v[j] != u[j] * v[i] for i, j in ((0, 1), (1, 2), (2, 0)))


def numbers_of_triangle(part: Triangles, k: int) -> list[np.ndarray]:
    """Corners, and normals and uv where they are used."""
    corners = part.faces[k]
    smooth, textured = part.smooth[k], part.textured[k]
    rest = [part.normals[corners]] if smooth else []
    return [part.vertices[corners], smooth, textured, *rest, *([part.uv[corners]] if textured else [])]


NO_AREA = KnownDefect(
    21,
    "a triangle without any area that Embree's robust mode hits all the same",
    3,
    "named",
    lambda m: m.without_area,
)
BEYOND_CORNERS = KnownDefect(
    28,
    "a triangle nearly edge-on: Embree's robust mode lets a ray in beyond an edge and gives a t beyond the corners",
    4,
    "named",
    lambda m: m.beyond_corners and m.cosine < NEARLY_EDGE_ON_COSINE,
)
VERTEX = KnownDefect(
    16,
    "a ray through the corner of a mesh, exactly: Embree's robust mode lets some slip through",
    7,
    "hit",
    lambda m: m.missed and "vertex" in m.where,
)
COLLINEAR = KnownDefect(
    22,
    "a triangle of three corners in a line but for their rounding",
    10,
    "either",
    lambda m: m.slenderness < COLLINEAR_HEIGHT_RATIO and m.nearly,
)
SLIVER = KnownDefect(
    19,
    "a sliver of a triangle",
    11,
    "either",
    lambda m: m.slenderness < SLIVER_HEIGHT_RATIO and m.nearly,
)
GRAZED = KnownDefect(
    26,
    "a triangle at grazing incidence",
    12,
    "either",
    lambda m: m.cosine < GRAZING_COSINE and m.nearly,
)
SMALL_AND_FAR = KnownDefect(
    35,
    "a triangle that is small and far away",
    18,
    "either",
    lambda m: m.distance > FAR_IN_SIZES and m.nearly,
)
FAR_FROM_ORIGIN = KnownDefect(
    34,
    "a triangle far from the origin",
    20,
    "either",
    lambda m: m.offset > FAR_IN_SIZES and m.nearly,
)

TRIANGLES = PrimitiveReference(
    Triangles,
    MODEL,
    describe_triangle,
    on_triangles,
    numbers=numbers_of_triangle,
    rounding_groups=(by_normal, *(partial(by_corner, axis) for axis in range(3))),
    known_defects=(
        STARTS_ON_FLAT,
        NO_AREA,
        BEYOND_CORNERS,
        VERTEX,
        COLLINEAR,
        SLIVER,
        GRAZED,
        SMALL_AND_FAR,
        FAR_FROM_ORIGIN,
    ),
    defect_view=view_triangle,
)

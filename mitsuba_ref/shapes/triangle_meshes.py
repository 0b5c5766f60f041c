"""Triangles: the primitive kind, whose error model is in surface_errors.py, and the shapes made of them.

Both sides trace these shapes as the same float32 triangles in world space; Mitsuba reads a PLY file. That includes
rectangles and cubes: Mitsuba's own take shading normals from the matrix, ours from the float32 corners, and the two
differ far from the origin; and if mirrored, geometric normals of Mitsuba's own point inwards.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from caster.description.fields import Shape
from caster.geometry.packing import Triangles
from caster.geometry.world_space import LARGEST_COORDINATE
from caster.shapes import Cube, Heightfield, Icosphere, Mesh, Rectangle, Teapot, Torus, Triangle
from mitsuba_ref.error_model.defect_conditions import (
    COLLINEAR_HEIGHT_RATIO,
    GRAZING_COSINE,
    NEARLY_EDGE_ON_COSINE,
    SLIVER_HEIGHT_RATIO,
    STARTS_ON_FLAT,
    DefectView,
    KnownDefect,
    abs_cosine,
    far_from_origin,
    small_and_far,
)
from mitsuba_ref.error_model.independent_transform import (
    ExpectedNumbers,
    ExpectedPacking,
    angle_weighted_normals,
    exactly,
    expected_points,
    transformed_normals,
)
from mitsuba_ref.error_model.intersections import Array, by_normal
from mitsuba_ref.error_model.tolerances import KU
from mitsuba_ref.oracle.exact_numbers import cross, sub
from mitsuba_ref.oracle.implicit_surfaces import exact_vector
from mitsuba_ref.shapes.shape_reference import (
    Fields,
    PrimitiveReference,
    RandomFields,
    ShapeReference,
    unit_vector_rounding_to,
)
from mitsuba_ref.shapes.surface_errors import MODEL
from mitsuba_ref.shapes.targets import (
    BESIDE_DECADES,
    MESH_FILES,
    Rng,
    SurfacePoints,
    coin_flip,
    random_fractions,
    random_point,
)


def describe_triangle(part: Triangles, k: int) -> Fields:
    """Fields of a triangle that packs to the numbers of triangle k."""
    corners = part.faces[k]
    shape: Fields = {"type": "triangle", "vertices": part.vertices[corners].tolist()}
    if part.smooth[k]:
        shape["normals"] = [unit_vector_rounding_to(n).tolist() for n in part.normals[corners]]
    if part.textured[k]:
        shape["uv"] = part.uv[corners].tolist()
    return shape


def on_triangles(prims: Any, k: Array, rng: Rng, sort: str) -> SurfacePoints:
    corners = prims.vertices[prims.faces[k]]
    corners = np.take_along_axis(corners, rng.permuted(np.tile(np.arange(3), (len(k), 1)), axis=1)[..., None], 1)
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


def view_triangle(prims: Any, k: int, o: Array, d: Array, t: float) -> DefectView:
    corners = prims.vertices[prims.faces[k]]
    edges = np.roll(corners, -1, axis=0) - corners
    longest = float(np.linalg.norm(edges, axis=1).max())
    across = np.cross(edges[0], edges[1])
    area = float(np.linalg.norm(across))
    along = (corners - o) @ d / float(d @ d)
    room = KU * (np.abs(along).max() + abs(t))  # for the rounding of t
    a, b, c = map(exact_vector, corners)
    return DefectView(
        cosine=abs_cosine(across, d),
        slenderness=area / longest**2 if longest > 0.0 else 0.0,
        beyond_corners=bool(t > along.max() + room or t < along.min() - room),
        without_area=not any(cross(sub(b, a), sub(c, a))),
    )


TRIANGLES = PrimitiveReference(
    Triangles,
    MODEL,
    describe_triangle,
    on_triangles,
    rounding_groups=(by_normal,),
    position_terms=lambda part, k, weights, p: np.einsum(
        "ij,ijk->ik", np.abs(weights), np.abs(part.vertices[part.faces[k]])
    ),
    known_defects=(
        STARTS_ON_FLAT,
        KnownDefect(
            21,
            "a triangle without area that Embree's robust mode hits nevertheless",
            3,
            lambda m: m.without_area,
            "named",
        ),
        KnownDefect(
            28,
            "a triangle nearly edge-on: Embree's robust mode accepts a ray beyond an edge, with a t beyond the corners",
            4,
            lambda m: m.beyond_corners and m.cosine < NEARLY_EDGE_ON_COSINE,
            "named",
        ),
        KnownDefect(
            16,
            "a ray exactly through the corner of a mesh: Embree's robust mode misses some",
            7,
            lambda m: "vertex" in m.where,
            "missed",
        ),
        KnownDefect(
            22,
            "a triangle whose corners are in a line up to rounding",
            10,
            lambda m: m.slenderness < COLLINEAR_HEIGHT_RATIO and m.nearly,
        ),
        KnownDefect(19, "a sliver of a triangle", 11, lambda m: m.slenderness < SLIVER_HEIGHT_RATIO and m.nearly),
        KnownDefect(26, "a triangle at grazing incidence", 12, lambda m: m.cosine < GRAZING_COSINE and m.nearly),
        KnownDefect(35, "a triangle that is small and far away", 18, small_and_far),
        KnownDefect(34, "a triangle far from the origin", 20, far_from_origin),
        KnownDefect(
            15,
            "a ray between two triangles: Embree's default mode loses some (mitsuba3 #1149); "
            "--as-in-file judges that mode",
            23,
            lambda m: not m.robust and m.nearly,
            "missed",
        ),
    ),
    defect_view=view_triangle,
)


def expected_mesh(shape: Any, part: Any) -> Iterator[ExpectedNumbers]:
    """Corners, faces with their orientation, uv and vertex normals."""
    given = shape.mesh()
    vertices = expected_points(shape, "vertices", part.vertices, given.vertices)
    corners, size = vertices.expected, vertices.size
    # A corner that is not finite or too far out is replaced by any other, and its faces become points.
    usable = (np.abs(corners) < LARGEST_COORDINATE).all(axis=1)
    corners[~usable], size[~usable] = part.vertices[~usable], 0.0
    yield vertices
    yield exactly("usable vertices", (np.abs(part.vertices) < LARGEST_COORDINATE).all(axis=1), np.ones(len(corners)))
    mirrored = np.linalg.slogdet(shape.matrix[:3, :3])[0] < 0.0
    faces = given.faces[:, [0, 2, 1]] if mirrored else given.faces.copy()
    rejected = ~usable[faces].all(axis=1)
    faces[rejected] = part.faces[rejected, :1]
    yield exactly("faces", part.faces, faces)
    yield exactly("textured", part.textured, np.full(len(given.faces), given.uv is not None))
    if given.uv is not None:
        yield ExpectedNumbers("uv", part.uv, given.uv, np.abs(given.uv))
    smooth = not getattr(shape, "face_normals", given.normals is None)
    yield exactly("smooth", part.smooth, np.full(len(given.faces), smooth))
    if smooth and given.normals is not None:
        keeps_lengths = getattr(shape, "keeps_lengths", False)
        yield ExpectedNumbers("normals", part.normals, *transformed_normals(shape.matrix, given.normals, keeps_lengths))
    elif smooth:
        yield ExpectedNumbers("generated normals", part.normals, *angle_weighted_normals(part.vertices, part.faces))


def expected_triangle(shape: Any, part: Any) -> Iterator[ExpectedNumbers]:
    """Corners, normals and uv in the order of the description, and the mesh in world space."""
    if shape.normals is not None:
        yield exactly("described normals", shape.mesh().normals, shape.normals)
    yield from expected_arrays(shape, part, [[0, 1, 2]])


def expected_arrays(shape: Any, part: Any, faces: Any) -> Iterator[ExpectedNumbers]:
    """The mesh in world space; corners, faces and uv in the order of the description. Normals may have any length."""
    given = shape.mesh()
    yield exactly("corners", given.vertices, shape.vertices)
    yield exactly("described faces", given.faces, faces)
    if shape.uv is not None:
        yield exactly("described uv", given.uv, shape.uv)
    yield from expected_mesh(shape, part)


def random_mesh(rng: Rng, lattice: bool) -> Fields:
    """A file or, once in four times, arrays: a tetrahedron, with or without normals and uv."""
    drawn = {"file": str(rng.choice(MESH_FILES)), "face_normals": coin_flip(rng)}
    more = rng.spawn(1)[0]
    if more.random() < 0.75:
        return drawn
    corners = [random_point(more, lattice) for _ in range(4)]
    arrays: Fields = {"vertices": corners, "faces": [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]}
    if coin_flip(more):
        arrays["normals"] = [[-1.0, -1.0, -1.0], [2.0, -1.0, -1.0], [-1.0, 2.0, -1.0], [-1.0, -1.0, 2.0]]
    if coin_flip(more):
        arrays["uv"] = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]
    return {"face_normals": drawn["face_normals"], **arrays}


def random_heightfield(rng: Rng, lattice: bool) -> Fields:
    amplitude = float(rng.choice([0.0, 0.25]))
    counts = {"resolution": int(rng.integers(1, 5)), "waves": 2, "seed": int(rng.integers(100))}
    return {"amplitude": amplitude, "face_normals": coin_flip(rng), **counts}


def triangle_mesh_reference(
    describes: type[Shape],
    random_fields: RandomFields = lambda rng, lattice: {},
    expected: ExpectedPacking = expected_mesh,
    groups: tuple[str, ...] = ("mesh",),
) -> ShapeReference:
    """Reference of a shape of triangles that Mitsuba reads from a PLY file."""
    return ShapeReference(
        describes, lambda out, shape, part: [out.mesh(shape, part)], (TRIANGLES,), expected, random_fields, groups
    )


FLAT_AND_SMALL = ("flat", "small")

TRIANGLE = triangle_mesh_reference(
    Triangle,
    lambda rng, lattice: {"vertices": [random_point(rng, lattice) for _ in range(3)]},
    expected_triangle,
    FLAT_AND_SMALL,
)
MESH = triangle_mesh_reference(
    Mesh,
    random_mesh,
    lambda shape, part: (
        expected_mesh(shape, part) if shape.file is not None else expected_arrays(shape, part, shape.faces)
    ),
)
RECTANGLE = triangle_mesh_reference(Rectangle, groups=FLAT_AND_SMALL)
CUBE = triangle_mesh_reference(Cube, groups=("flat", "mesh"))
ICOSPHERE = triangle_mesh_reference(
    Icosphere, lambda rng, _: {"subdivisions": int(rng.integers(0, 2)), "face_normals": coin_flip(rng)}
)
TORUS = triangle_mesh_reference(
    Torus,
    lambda rng, lattice: {
        "segments": int(rng.integers(3, 7)),
        "sides": int(rng.integers(3, 6)),
        "face_normals": coin_flip(rng),
        "major_radius": 0.75,
        "minor_radius": 0.25,
    },
)
HEIGHTFIELD = triangle_mesh_reference(Heightfield, random_heightfield)
TEAPOT = triangle_mesh_reference(Teapot, lambda rng, _: {"subdivisions": 1, "face_normals": coin_flip(rng)})

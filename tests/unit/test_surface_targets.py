"""What the fuzzer aims at and draws shapes and cameras from: points on surfaces, meshes made by hand, random fields.

A generator that no longer gives some of its kinds would only make the fuzzer and `knife_edges` weaker: nothing fails.
"""

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest

import caster
from caster.geometry.packing import Triangles, pack
from caster.scene.model import Scene
from caster.shapes.cylinder import Cylinders
from caster.shapes.disk import Disks
from caster.shapes.mesh import MeshFile
from caster.shapes.plane import Planes
from caster.shapes.sphere import Ellipsoids, Spheres
from mitsuba_ref import cameras
from mitsuba_ref.shapes import KINDS, REFERENCES, targets
from mitsuba_ref.shapes.triangle_meshes import view_triangle

SORTS = targets.POINT_KINDS
COUNT = 600
PLACE = [{"matrix": [[2, 0.5, 0, 1], [0, 0.75, 0.25, 2], [0.125, 0, -1.5, 3], [0, 0, 0, 1]]}]
CORNERS = (((0, 0, 1), (4, 0, 2), (1, 3, 3)), ((1, 1, 1), (-2, 1, 0), (0, 2, 5)))
SHAPES = {
    Spheres: (caster.SphereCloud(centers=((1, 2, 3), (-4, 0, 1)), radii=(0.5, 3.0)),),
    Ellipsoids: (caster.Sphere(to_world=PLACE), caster.Sphere(center=(3, 0, 1), radius=0.5, to_world=PLACE)),
    Disks: (caster.Disk(to_world=PLACE), caster.Disk(to_world=[{"translate": [1, 2, 3]}])),
    Cylinders: (caster.Cylinder(to_world=PLACE), caster.Cylinder(p0=(1, 0, 0), p1=(4, 1, 1), radius=0.25)),
    Planes: (caster.Plane(point=(1, 2, 3), normal=(1, 2, 4)), caster.Plane(point=(0, 5, 0), normal=(0, -1, 0))),
    Triangles: tuple(caster.Triangle(vertices=each) for each in CORNERS),
}


def prims_of(kind: type) -> Any:
    camera = caster.Pinhole(eye=(0, 0, 9), look_at=(0, 0, 0))
    (found,) = pack(Scene(camera=camera, shapes=list(SHAPES[kind]))).kinds
    assert type(found.prims) is kind
    return found.prims


def drawn(kind: type, sort: str, seed: int = 3) -> tuple[Any, np.ndarray, targets.SurfacePoints]:
    """(primitives, which (m,), points on them), of two primitives in turn."""
    prims, k = prims_of(kind), np.arange(COUNT) % 2
    return (prims, k, KINDS[kind].surface_points(prims, k, np.random.default_rng([seed, SORTS.index(sort)]), sort))


def in_object_space(
    prims: Any, k: np.ndarray, points: targets.SurfacePoints
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """p, along and normal of points, where the shape has its unit size; by inverses that are computed here."""
    if hasattr(prims, "radius"):
        r = prims.radius[k][:, None]
        return (points.p - prims.center[k]) / r, points.along / r, points.n
    matrices = prims.to_world[k]
    p = np.linalg.solve(matrices, (points.p - prims.center[k])[..., None])[..., 0]
    along = np.linalg.solve(matrices, points.along[..., None])[..., 0]
    return p, along, np.einsum("ijk,ij->ik", matrices, points.n)


def decades_are_spread(x: np.ndarray) -> bool:
    """From 1e-16 to 1e-2, all of them alike; float64 shows them from 1e-14 or so on."""
    seen = np.log10(x[x > 1e-13])
    return x.min() > -1e-13 and x.max() < 1.001e-2 and np.histogram(seen, 5, (-13.0, -2.0))[0].min() > 0.08 * len(x)


def is_across(a: np.ndarray, b: np.ndarray) -> bool:
    lengths = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    return bool((lengths > 0.0).all() and (np.abs(np.sum(a * b, axis=1)) < 1e-13 * lengths).all())


def is_parallel(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(
        (np.linalg.norm(np.cross(a, b), axis=1) < 1e-13 * np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)).all()
    )


def test_every_kind_has_a_shape_here():
    assert set(SHAPES) == set(KINDS)


@pytest.mark.parametrize("sort", SORTS)
@pytest.mark.parametrize("kind", [Spheres, Ellipsoids], ids=lambda kind: kind.__name__)
def test_points_lie_on_a_sphere_or_just_outside(kind, sort):
    prims, k, points = drawn(kind, sort)
    p, along, n = in_object_space(prims, k, points)
    length = np.linalg.norm(p, axis=1)
    assert decades_are_spread(length - 1.0) if sort == "beside" else np.abs(length - 1.0).max() < 1e-13
    assert is_across(along, p) and is_parallel(n, p) and (np.sum(n * p, axis=1) > 0.0).all()
    turned = (np.abs(p) < 1e-13).any(axis=1).mean()  # in a plane of two axes
    assert turned == 1.0 if sort == "corner" else 0.2 < turned < 0.4
    assert {tuple(octant) for octant in np.sign(np.round(p[:, :3], 9)).astype(int)} >= {
        *((1, 1, 0), (-1, 0, 1), (0, -1, -1), (0, 0, 1), (-1, 0, 0))
    }


@pytest.mark.parametrize("sort", SORTS)
def test_points_lie_on_the_wall_of_a_cylinder_and_at_its_ends(sort):
    prims, k, points = drawn(Cylinders, sort)
    p, along, n = in_object_space(prims, k, points)
    radius, z = np.hypot(p[:, 0], p[:, 1]), p[:, 2]
    assert np.abs(radius - 1.0).max() < 1e-13
    beyond = np.maximum(-z, z - 1.0)
    if sort == "beside":
        assert decades_are_spread(beyond) and 0.4 < np.mean(z > 0.5) < 0.6
    elif sort == "corner":
        assert np.abs(beyond).max() < 1e-14 and 0.4 < np.mean(z > 0.5) < 0.6
    else:
        assert beyond.max() < 1e-14 and np.histogram(z, 4, (0.0, 1.0))[0].min() > 0.15 * COUNT
    around = np.abs(along[:, 2]) < 1e-13 * np.linalg.norm(along, axis=1)
    assert is_across(along, p * [1, 1, 0]) and 0.4 < around.mean() < 0.6
    assert np.linalg.norm(along[~around][:, :2], axis=1).max() < 1e-13
    assert is_parallel(n, p * [1, 1, 0]) and (np.sum(n * p * [1, 1, 0], axis=1) > 0.0).all()


@pytest.mark.parametrize("sort", SORTS)
def test_points_lie_in_a_disk_or_on_its_rim(sort):
    prims, k, points = drawn(Disks, sort)
    p, along, n = in_object_space(prims, k, points)
    radius = np.hypot(p[:, 0], p[:, 1])
    assert np.abs(p[:, 2]).max() < 1e-13 and np.abs(along[:, 2]).max() < 1e-13
    if sort == "inside":
        assert radius.max() < 1.0 + 1e-14 and np.histogram(radius, 4, (0.0, 1.0))[0].min() > 0.15 * COUNT
    else:
        assert decades_are_spread(radius - 1.0) if sort == "beside" else np.abs(radius - 1.0).max() < 1e-13
    rows = radius > 0.5
    out = np.abs(np.sum(p * along, axis=1)[rows] / radius[rows])
    assert np.minimum(out, np.abs(out - 1.0)).max() < 1e-12 and 0.3 < np.mean(out > 0.5) < 0.7
    assert is_parallel(n, np.tile([0.0, 0.0, 1.0], (COUNT, 1))) and (n[:, 2] > 0.0).all()


@pytest.mark.parametrize("sort", SORTS)
def test_points_lie_in_a_plane_on_every_side_of_its_point(sort):
    prims, k, points = drawn(Planes, sort)
    n, away = prims.normal[k], points.p - prims.point[k]
    assert is_parallel(points.n, n) and is_across(points.along, n)
    assert np.abs(np.sum(away * n, axis=1)).max() < 1e-14
    if sort == "corner":
        assert not away.any()
        return
    first = points.along[k == 0]
    directions = [first[0], next(each for each in first if abs(each @ first[0]) < 1e-12)]
    for each in directions:  # two ways across each other: both are gone along, and both are reached, apart
        steps = away[k == 0] @ each / (each @ each)
        assert np.abs(steps).max() <= 1.0 + 1e-14 and np.histogram(np.abs(steps), 4, (0.0, 1.0))[0].min() > 30
    both = np.abs(away[k == 0] @ np.array(directions).T)
    assert abs(np.corrcoef(both.T)[0, 1]) < 0.2
    assert 0.4 < np.mean(np.abs(first @ directions[0]) > 1e-12) < 0.6


@pytest.mark.parametrize("sort", SORTS)
def test_points_lie_at_corners_and_on_edges_of_a_triangle_beside_them_or_inside(sort):
    prims, k, points = drawn(Triangles, sort)
    corners = prims.vertices[prims.faces[k]]
    a, b, c = (corners[:, j] for j in range(3))
    n = np.cross(b - a, c - a)
    assert is_parallel(points.n, n) and is_across(points.along, n)
    weights = np.linalg.solve(np.swapaxes(corners - 9.0, 1, 2), (points.p - 9.0)[..., None])[
        ..., 0
    ]  # from another point
    assert np.abs(weights.sum(axis=1) - 1.0).max() < 1e-12
    places = Counter(tuple(row) for row in (np.abs(weights) > 1e-12).astype(int).tolist())
    edges = np.stack([b - a, c - b, a - c], axis=1)
    along_edge = np.linalg.norm(np.cross(edges, points.along[:, None]), axis=2).min(axis=1) < 1e-12
    if sort == "corner":
        assert np.abs(np.sort(weights, axis=1) - [0.0, 0.0, 1.0]).max() < 1e-12
        assert min(places.values()) > 0.2 * COUNT and len(places) == 3 and 0.6 < along_edge.mean() < 0.95
        return
    if sort == "inside":
        assert weights.min() > -1e-12 and np.median(weights.min(axis=1)) > 0.02 and 0.6 < along_edge.mean() < 0.95
        for column in np.sort(weights, axis=1).T[1:]:
            assert np.ptp(column) > 0.3
        return
    out = -weights.min(axis=1)
    lowest = np.bincount(np.argmin(weights, axis=1), minlength=3)
    assert lowest.min() > 0.2 * COUNT and along_edge.all()
    assert decades_are_spread(out) if sort == "beside" else np.abs(out).max() < 1e-12
    share = np.sort(weights, axis=1)[:, 1] / (1.0 + np.maximum(out, 0.0))
    assert share.min() > -1e-12 and np.histogram(share, 4, (0.0, 0.5))[0].min() > 0.1 * COUNT


# ---- numbers


def test_points_of_a_circle_are_on_axes_pythagorean_or_any():
    c, s = targets.unit_circle_points(np.random.default_rng(4), 4000)
    assert np.abs(np.hypot(c, s) - 1.0).max() < 3e-16
    axis, simple = np.minimum(np.abs(c), np.abs(s)) == 0.0, np.isin(np.abs(c), (0.6, 0.8))
    assert np.isin(np.abs(s[simple]), (0.6, 0.8)).all()
    assert 0.3 < axis.mean() < 0.37 and 0.3 < simple.mean() < 0.37
    assert 0.45 < np.mean(np.abs(c) > np.abs(s)) < 0.55
    for rows in (simple, ~(simple | axis)):
        signs = Counter(zip(np.sign(c[rows]), np.sign(s[rows]), strict=True))
        assert len(signs) == 4 and min(signs.values()) > 0.2 * rows.sum()
    ends = Counter((np.sign(c[axis]) + 2 * np.sign(s[axis])).tolist())
    assert len(ends) == 4 and min(ends.values()) > 0.2 * axis.sum()
    angles = np.arctan2(s, c)[~(simple | axis)]
    assert np.histogram(angles, 8, (-np.pi, np.pi))[0].min() > 0.08 * len(angles)


def test_fractions_are_eighths_or_any():
    found = targets.random_fractions(np.random.default_rng(5), 4000)
    assert found.shape == (4000, 1) and found.min() == 0.0 and found.max() == 1.0
    eighths = found[found * 8.0 % 1.0 == 0.0]
    assert 0.45 < len(eighths) / 4000 < 0.55
    assert np.bincount((eighths * 8.0).astype(int), minlength=9).min() > 0.07 * len(eighths)
    assert np.histogram(found[found * 8.0 % 1.0 != 0.0], 8, (0.0, 1.0))[0].min() > 0.1 * 2000


def test_points_and_lengths_are_of_the_lattice_or_any():
    rng = np.random.default_rng(6)
    on, off = (np.array([targets.random_point(rng, lattice) for _ in range(700)]) for lattice in (True, False))
    assert set((on * 8.0).ravel()) == set(range(-8, 9)) and on.shape == (700, 3)
    assert (off * 8.0 % 1.0 != 0.0).all() and np.histogram(off, 8, (-1.0, 1.0))[0].min() > 0.1 * off.size
    on, off = (np.array([targets.random_length(rng, lattice) for _ in range(700)]) for lattice in (True, False))
    assert set(on * 8.0) == set(range(1, 9))
    assert (
        np.histogram(np.log10(off), 5, (-1.5, 0.0))[0].min() > 0.15 * 700 and 10.0**-1.5 <= off.min() <= off.max() < 1.0
    )
    assert 300 < sum(targets.coin_flip(rng) for _ in range(700)) < 400


def test_directions_are_any_small_whole_numbers_or_axes():
    found = targets.random_directions(np.random.default_rng(7), 4000)
    size = np.abs(found)
    axes = (np.sort(size, axis=1) == [0.0, 0.0, 1.0]).all(axis=1)
    whole = (found % 1.0 == 0.0).all(axis=1) & ~axes
    rest = found[~(whole | axes)]
    assert 0.56 < len(rest) / 4000 < 0.64 and 0.2 < whole.mean() < 0.28 and 0.13 < axes.mean() < 0.2
    assert np.abs(np.linalg.norm(rest, axis=1) - 1.0).max() < 1e-15
    assert len(np.unique(np.sign(rest), axis=0)) == 8 and len(np.unique(found[axes], axis=0)) == 6
    assert size[whole].max() == 3.0 and found[whole].min() == -3.0 and size[whole].any(axis=1).all()
    counts = np.bincount((found[whole] + 3.0).astype(int).ravel(), minlength=7)
    assert counts.min() > 0.1 * counts.sum()


# ---- meshes


def doubled_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, j]] for j in range(3))
    return np.cross(b - a, c - a)


def is_closed(faces: np.ndarray) -> bool:
    edges = Counter((int(f[j]), int(f[(j + 1) % 3])) for f in faces for j in range(3))
    return set(edges.values()) == {1} and all((b, a) in edges for a, b in edges)


def test_the_octahedron_is_closed_and_has_its_outside_outside():
    vertices, faces = targets.octahedron()
    assert is_closed(faces) and faces.shape == (8, 3)
    assert {tuple(v) for v in vertices.tolist()} == {tuple(s * e) for e in np.eye(3) for s in (1.0, -1.0)}
    middles = vertices[faces].mean(axis=1)
    assert np.array_equal(doubled_areas(vertices, faces), 3.0 * middles)  # each faces away, with sides of sqrt(2)


def test_the_dented_icosphere_is_an_icosahedron_with_other_radii():
    vertices, faces = targets.dented_icosphere()
    radii = np.linalg.norm(vertices, axis=1)
    assert is_closed(faces) and vertices.shape == (12, 3) and faces.shape == (20, 3)
    assert 0.6 <= radii.min() < 0.75 and 0.85 < radii.max() <= 1.0 and len(set(radii)) == 12
    angles = np.unique(np.round((vertices / radii[:, None]) @ (vertices / radii[:, None]).T, 12))
    assert np.abs(angles - [-1.0, -(0.2**0.5), 0.2**0.5, 1.0]).max() < 1e-11
    assert np.array_equal(vertices, targets.dented_icosphere()[0])


def test_the_fan_has_twelve_needles_each_about_seven_times_as_wide_as_the_one_before():
    vertices, faces = targets.fan_of_slivers()
    assert vertices.shape == (14, 3) and faces.tolist() == [[0, i, i + 1] for i in range(1, 13)]
    assert not vertices[0].any() and not vertices[:, 2].any() and np.array_equal(vertices[1], [1.0, 0.0, 0.0])
    sines = doubled_areas(vertices, faces)[:, 2]
    angles = np.arcsin(sines)
    assert angles == pytest.approx(10.0 ** np.linspace(-9.0, 0.0, 12), rel=1e-6)
    assert np.abs(np.linalg.norm(vertices[1:], axis=1) - 1.0).max() < 1e-15


def test_the_sheet_is_a_square_of_eight_triangles_with_lines_points_and_one_more_among_them():
    vertices, faces = targets.pinched_sheet()
    areas = doubled_areas(vertices, faces)
    assert {tuple(v) for v in vertices.tolist()} == {(x, y, 0.0) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)}
    assert len(vertices) == 9 and areas[:8].tolist() == [[0.0, 0.0, 1.0]] * 8 and not areas[8:].any()
    assert len({frozenset(map(tuple, vertices[f].tolist())) for f in faces[:8]}) == 8
    inner = Counter(frozenset((int(f[j]), int(f[(j + 1) % 3]))) for f in faces[:8] for j in range(3))
    assert sorted(inner.values()) == [1] * 8 + [2] * 8
    assert [len({tuple(p) for p in vertices[f].tolist()}) for f in faces[8:]] == [3, 2, 1, 3]


def test_the_doubled_square_has_each_half_as_given_reversed_and_of_other_vertices():
    vertices, faces = targets.doubled_square()
    places = [tuple(map(tuple, vertices[f].tolist())) for f in faces]
    assert len(vertices) == 8 and np.array_equal(vertices[:4], vertices[4:])
    assert {*map(tuple, vertices.tolist())} == {(x, y, 0.0) for x in (-1.0, 1.0) for y in (-1.0, 1.0)}
    assert [set(place) for place in places] == [set(places[i % 2]) for i in range(6)] and set(places[0]) != set(
        places[1]
    )
    assert doubled_areas(vertices, faces)[:, 2].tolist() == [4.0, 4.0, -4.0, -4.0, 4.0, 4.0]
    assert faces[:4].max() == 3 and faces[4:].min() == 4 and places[4:] == places[:2]


def test_mesh_files_are_these_meshes():
    for path, make in zip(targets.mesh_files(), targets.MESH_BUILDERS, strict=True):
        mesh, (vertices, faces) = MeshFile(file=path).mesh(), make()
        assert path.endswith(f"{make.__name__}.obj") and np.array_equal(mesh.vertices[mesh.faces], vertices[faces])


# ---- fields of shapes and cameras

REFERENCES_BY_NAME = {each.type_name: each for each in REFERENCES.values()}
CAMERAS_BY_NAME = {each.type_name: each for each in cameras.REFERENCES.values()}


def fields_of(name: str, lattice: bool, count: int = 400) -> list[dict[str, Any]]:
    rng = np.random.default_rng([8, lattice])
    found = [REFERENCES_BY_NAME[name].random_fields(rng, lattice) for _ in range(count)]
    for each in found[:20]:
        REFERENCES_BY_NAME[name].describes.model_validate(each)
    return found


def values(found: list[dict[str, Any]], field: str) -> np.ndarray:
    return np.array([each[field] for each in found if field in each])


def share(found: list[dict[str, Any]], field: str) -> float:
    return sum(field in each for each in found) / len(found)


def on_lattice(x: np.ndarray) -> bool:
    return bool((np.asarray(x) * 8.0 % 1.0 == 0.0).all())


@pytest.mark.parametrize("lattice", [False, True])
def test_random_quadrics_are_plain_half_of_the_time_and_else_of_about_unit_size(lattice):
    balls, tubes, clouds = (fields_of(name, lattice) for name in ("sphere", "cylinder", "spheres"))
    for found, names in ((balls, ("center", "radius")), (tubes, ("p0", "p1", "radius"))):
        assert all(set(each) in (set(), set(names)) for each in found)
        assert 0.43 < share(found, "radius") < 0.57
        for name in names:
            assert on_lattice(values(found, name)) is lattice and 0.8 < np.abs(values(found, name)).max() <= 2.0
    assert all(each["p0"] != each["p1"] for each in tubes if each)
    counts = Counter(len(each["centers"]) for each in clouds)
    assert set(counts) == set(range(1, 9)) and min(counts.values()) > 30
    assert all(("radius" in each) is not ("radii" in each) for each in clouds) and 0.43 < share(clouds, "radius") < 0.57
    assert all(len(each["radii"]) == len(each["centers"]) for each in clouds if "radii" in each)
    assert on_lattice(np.concatenate([each["centers"] for each in clouds])) is lattice
    assert on_lattice(values(clouds, "radius")) is lattice


def test_a_random_cylinder_whose_ends_coincide_is_made_longer():
    class Same:
        """Draws the same numbers again and again."""

        def random(self) -> float:
            return 0.75

        def integers(self, low: int, high: int, size: int = 1) -> np.ndarray:
            return np.full(size, high - 1) if size > 1 else high - 1

    fields = REFERENCES_BY_NAME["cylinder"].random_fields(Same(), True)
    assert fields == {"p0": [1.0, 1.0, 1.0], "p1": [1.0, 1.0, 2.0], "radius": 1.0}


@pytest.mark.parametrize("lattice", [False, True])
def test_random_flat_shapes_are_of_the_lattice_where_it_says_so(lattice):
    planes, triangles = fields_of("plane", lattice), fields_of("triangle", lattice)
    assert all(set(each) in ({"normal", "point"}, {"normal", "offset"}) for each in planes)
    assert 0.43 < share(planes, "point") < 0.57
    for found in (values(planes, "point"), values(planes, "offset"), values(triangles, "vertices")):
        assert on_lattice(found) is lattice and found.min() < -0.9 and found.max() > 0.9 and np.abs(found).max() <= 1.0
    assert values(triangles, "vertices").shape == (400, 3, 3)
    assert np.linalg.norm(values(planes, "normal"), axis=1).min() > 0.99
    assert all(not REFERENCES_BY_NAME[name].random_fields(None, lattice) for name in ("disk", "cube", "rectangle"))


def test_random_meshes_are_small_and_of_every_size_there_may_be():
    expected: dict[str, dict[str, set[Any]]] = {
        "mesh": {"file": set(targets.mesh_files())},
        "icosphere": {"subdivisions": {0, 1}},
        "torus": {"major_radius": {0.75}, "minor_radius": {0.25}, "segments": {3, 4, 5, 6}, "sides": {3, 4, 5}},
        "heightfield": {"amplitude": {0.0, 0.25}, "resolution": {1, 2, 3, 4}, "waves": {2}},
        "teapot": {"subdivisions": {1}},
    }
    for name, fields in expected.items():
        found = fields_of(name, False)
        for field, choices in fields.items():
            counts = Counter(each[field] for each in found)
            assert set(counts) == choices and min(counts.values()) > 0.7 * 400 / len(choices), (name, field)
        assert 0.43 < values(found, "face_normals").mean() < 0.57
    seeds = values(fields_of("heightfield", False, 2000), "seed")
    assert set(seeds.tolist()) == set(range(100))


VIEW = {"eye": [1.0, 2.0, 3.0], "direction": [0.0, 0.0, -1.0], "up": [0.0, 1.0, 0.0]}


def cameras_of(name: str, size: float) -> list[dict[str, Any]]:
    rng = np.random.default_rng(9)
    found = [CAMERAS_BY_NAME[name].random_fields(rng, size, lambda: dict(VIEW)) for _ in range(1500)]
    for each in found[:20]:
        CAMERAS_BY_NAME[name].describes.model_validate({**each})
    return found


def is_uniform(x: np.ndarray, low: float, high: float) -> bool:
    return bool(low <= x.min() and x.max() < high and np.histogram(x, 5, (low, high))[0].min() > 0.12 * len(x))


@pytest.mark.parametrize("size", [1.0, 40.0])
def test_random_cameras_have_near_and_far_planes_now_and_then(size):
    found = cameras_of("pinhole", size)
    assert all(each.items() >= VIEW.items() for each in found)
    assert 0.26 < share(found, "near") < 0.34 and 0.17 < share(found, "far") < 0.23
    assert is_uniform(values(found, "near") / size, 0.0, 1.5) and is_uniform(values(found, "far") / size, 2.0, 9.0)
    fov = values(found, "fov")
    assert len(fov) == len(found) and 0.45 < np.mean(fov == 90.0) < 0.55 and is_uniform(fov[fov != 90.0], 5.0, 150.0)
    found = cameras_of("orthographic", size)
    assert all(each.items() >= VIEW.items() and "far" not in each for each in found)
    widths = Counter((values(found, "width") / size).tolist())
    assert set(widths) == {0.5, 1.0, 2.0, 4.0} and min(widths.values()) > 300
    assert 0.17 < share(found, "near") < 0.23 and is_uniform(values(found, "near") / size, 0.0, 1.5)


def test_random_cameras_without_a_sensor_are_views_and_a_fisheye_of_any_angle():
    assert is_uniform(values(cameras_of("fisheye", 2.0), "fov"), 60.0, 360.0)
    assert all(each.items() >= VIEW.items() for each in cameras_of("fisheye", 2.0))
    for name in ("panorama", "parabolic"):
        assert cameras_of(name, 2.0)[0] == VIEW
    assert cameras_of("ray", 2.0)[0] == {"origin": VIEW["eye"], "direction": VIEW["direction"]}


# ---- what is measured at a triangle for the known defects


@pytest.mark.parametrize(
    ("t", "beyond"),
    [
        (1.0, True),
        (2.0 - 1e-5, True),
        (2.0, False),
        (2.5, False),
        (4.0, False),
        (4.0 + 1e-5, True),
        (9.0, True),
        (-3.0, True),
    ],
)
def test_a_t_is_beyond_the_corners_of_a_triangle_before_the_nearest_or_behind_the_farthest(t, beyond):
    """Corners at t = 2, 3 and 4 of a ray of length 2; 1e-6 beyond them is rounding."""
    prims = Triangles(
        np.array([[5.0, 0, 2], [-1, 7, 4], [2, -3, 6]]), np.array([[0, 1, 2]]), *([None] * (len(Triangles._fields) - 2))
    )
    o, d = np.array([7.0, 0.0, -2.0]), np.array([0.0, 0.0, 2.0])
    assert view_triangle(prims, 0, o, d, t).beyond_corners is beyond
    for off in (1e-6, -1e-6):
        assert view_triangle(prims, 0, o, d, t + off).beyond_corners is beyond


def test_a_triangle_is_as_slender_as_its_height_over_its_longest_edge():
    corners = np.array([[0.0, 0, 0], [4, 0, 0], [1, 0.5, 0], [2, 0, 0], [0, 0, 0]])
    faces = np.array([[0, 1, 2], [2, 0, 1], [0, 1, 3], [0, 4, 4]])
    prims = Triangles(corners, faces, *([None] * (len(Triangles._fields) - 2)))
    d = np.array([3.0, 0.0, 4.0])
    views = [view_triangle(prims, k, np.ones(3), d, 1.0) for k in range(4)]
    assert [view.slenderness for view in views] == [0.125, 0.125, 0.0, 0.0]
    assert [view.without_area for view in views] == [False, False, True, True]
    assert [view.cosine for view in views] == pytest.approx([0.8, 0.8, 1.0, 1.0]) and math.isfinite(views[3].cosine)

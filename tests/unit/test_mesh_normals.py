"""Generated normals and the checks on a mesh."""

import math

import numpy as np
import pytest

from caster.description.errors import SceneError
from caster.geometry.triangle_mesh import Mesh, check_mesh, normalize_rows, vertex_normals
from caster.geometry.world_space import as_given
from caster.shapes import Icosphere

# About twenty roundings of u = 2^-53 lie between the corners and a component of a unit vector.
ROUNDING = 32 * 2.0**-53

CORNER = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], float)
CORNER_FACES = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 1)], np.int32)


@pytest.fixture
def rng():
    return np.random.default_rng(20)


def mesh_of(**changes):
    mesh = Mesh(CORNER, CORNER_FACES)
    return mesh._replace(**changes)


def test_normals_are_weighted_by_angle_not_by_area():
    """The face in z = 0 has the larger area at vertex 0, the upright one the larger angle."""
    narrow, wide = math.radians(30), math.radians(90)
    vertices = np.array([(0, 0, 0), (9, 0, 0), (9 * math.cos(narrow), 9 * math.sin(narrow), 0), (0, 0, 0.1)], float)
    normal = vertex_normals(vertices, np.array([(0, 1, 2), (0, 3, 1)], np.int32))[0]
    expected = np.array([0, wide, narrow]) / math.hypot(wide, narrow)
    assert np.abs(normal - expected).max() <= ROUNDING


def some_faces(rng):
    return rng.normal(size=(20, 3)), np.array([rng.choice(20, 3, replace=False) for _ in range(40)], np.int32)


@pytest.mark.parametrize("exponent", [-1000, -300, 300, 900])
def test_a_power_of_two_in_size_does_not_change_a_bit(rng, exponent):
    vertices, faces = some_faces(rng)
    scaled = vertex_normals(np.ldexp(vertices, exponent), faces)
    assert np.array_equal(vertex_normals(vertices, faces), scaled)


def test_mirroring_the_mesh_mirrors_the_normals_to_the_bit(rng):
    vertices, faces = some_faces(rng)
    mirrored = vertex_normals(vertices * (-1, 1, 1), faces)  # a cross product mirrors the other two axes
    assert np.array_equal(vertex_normals(vertices, faces) * (1, -1, -1), mirrored)


def test_isolated_and_degenerate_vertices_get_the_x_axis():
    vertices = np.array([(0, 0, 0), (1, 2, 3), (2, 4, 6), (7, 7, 7)], float)
    normals = vertex_normals(vertices, np.array([(0, 1, 2), (0, 0, 1)], np.int32))
    assert np.array_equal(normals, [(1, 0, 0)] * 4)


def test_a_degenerate_face_adds_nothing():
    faces = np.array([(0, 1, 2), (0, 0, 1), (1, 1, 1)], np.int32)
    assert np.array_equal(vertex_normals(CORNER, faces)[:3], [(0, 0, 1)] * 3)


def test_unit_rows_keeps_zeros_and_spans_all_magnitudes():
    rows = normalize_rows(np.array([(0, 0, 0), (3e300, 4e300, 0), (0, 3e-320, 4e-320), (0, 0, -5e-324)], float))
    # 3e-320 has 13 bits only: its direction is off by 2^-13
    assert np.abs(rows - [(0, 0, 0), (0.6, 0.8, 0), (0, 0.6, 0.8), (0, 0, -1)]).max() <= 2.0**-12
    assert np.abs(np.linalg.norm(rows[1:], axis=1) - 1).max() <= ROUNDING


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"faces": np.zeros((0, 3), np.int32)}, "no faces"),
        ({"vertices": np.zeros((0, 3)), "faces": np.zeros((0, 3), np.int32)}, "no faces"),
        ({"faces": np.array([(0, 1, 2), (0, 1, 4)], np.int32)}, r"face 1 .*0 to 3.*\(0, 1, 4\)"),
        ({"faces": np.array([(0, -1, 2)], np.int32)}, r"face 0 .*\(0, -1, 2\)"),
        ({"normals": CORNER}, r"normal of vertex 0 .*\(0, 0, 0\)"),
    ],
)
def test_an_unusable_mesh_is_refused_with_the_culprit_named(changes, words):
    with pytest.raises(SceneError, match=r"^somewhere: .*" + words):
        check_mesh(mesh_of(**changes), "somewhere")


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("power", [-390, 0, 50])
def test_faces_of_a_mesh_of_any_size_look_outwards_also_where_it_is_mirrored(power, mirrored):
    """The volume of the smallest one, by which a mirror image is known, is below all of float64."""
    size = 2.0**power
    part = Icosphere(to_world={"scale": [-size if mirrored else size, size, size]}).pack(as_given)
    a, b, c = np.moveaxis(part.vertices[part.faces] / size, 1, 0)
    assert (np.sum(np.cross(b - a, c - a) * a, axis=1) > 0.0).all()
    assert (np.sum(part.normals * part.vertices / size, axis=1) > 0.0).all()

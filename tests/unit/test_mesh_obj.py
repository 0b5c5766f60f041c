"""Wavefront OBJ files."""

import math
import os

import numpy as np
import pytest

from caster.description.errors import FileMissing, SceneError
from caster.geometry.mesh_files import _check_stl_size, load_mesh, parse_off
from caster.geometry.mesh_files.obj import join_table
from caster.geometry.triangle_mesh import vertex_normals
from caster.shapes.mesh import MeshFile

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
SQUARE_VERTICES = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


@pytest.fixture
def load(tmp_path):
    def load_text(text):
        path = tmp_path / "mesh.obj"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load_mesh(path)

    return load_text


def test_vertices_keep_the_order_of_the_file(load):
    mesh = load(SQUARE + "v 9 9 9\nf 3 2 1\n")
    assert np.array_equal(mesh.vertices, [*SQUARE_VERTICES, (9, 9, 9)])
    assert np.array_equal(mesh.faces, [(2, 1, 0)])
    assert mesh.normals is None and mesh.uv is None
    assert mesh.vertices.dtype == np.float64 and mesh.faces.dtype == np.int32


def test_a_polygon_becomes_a_fan_around_its_first_corner(load):
    mesh = load(SQUARE + "v 0 .5 0\nf 1 2 3\nf 1 2 3 4 5\nf 3 4 5\n")
    assert np.array_equal(mesh.faces, [(0, 1, 2), (0, 1, 2), (0, 2, 3), (0, 3, 4), (2, 3, 4)])


def test_negative_indices_count_back_from_their_line(load):
    mesh = load("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 5 5 5\nf -4 -1 2\n")
    assert np.array_equal(mesh.faces, [(0, 1, 2), (0, 3, 1)])


def test_negative_texture_and_normal_indices_count_their_own_lists(load):
    mesh = load("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvn 0 0 1\nf -3/-2/-1 -2/-1/-1 -1/-2/-1\n")
    same = load("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvn 0 0 1\nf 1/1/1 2/2/1 3/1/1\n")
    for ours, expected in zip(mesh, same, strict=True):
        assert np.array_equal(ours, expected)


def test_v_of_uv_is_turned_over(load):
    mesh = load(SQUARE + "vt 0.25 0.75\nvt 1\nvt 0 0 0.5\nf 1/1 2/2 3/3\n")
    assert np.array_equal(mesh.uv, [(0.25, 0.25), (1, 1), (0, 1)])
    assert mesh.normals is None


def test_a_corner_shared_with_another_normal_is_split_in_file_order(load):
    mesh = load(SQUARE + "vn 0 0 1\nvn 1 0 0\nf 1//2 2//1 3//1\nf 1//1 3//1 4//1\n")
    assert np.array_equal(mesh.vertices, [SQUARE_VERTICES[k] for k in (0, 0, 1, 2, 3)])
    assert np.array_equal(mesh.normals, [(0, 0, 1), (1, 0, 0), (0, 0, 1), (0, 0, 1), (0, 0, 1)])
    assert np.array_equal(mesh.faces, [(1, 2, 3), (0, 3, 4)])


def test_splitting_does_not_depend_on_the_order_of_the_faces(load):
    corners = "vt 0 0\nvt 1 1\n"
    one = load(SQUARE + corners + "f 1/1 2/1 3/2\nf 1/2 3/1 4/1\n")
    other = load(SQUARE + corners + "f 1/2 3/1 4/1\nf 1/1 2/1 3/2\n")
    assert np.array_equal(one.vertices, other.vertices) and np.array_equal(one.uv, other.uv)
    assert np.array_equal(one.faces, other.faces[::-1])


def test_an_index_written_in_two_ways_is_one_vertex(load):
    mesh = load(SQUARE + "vn 0 0 1\nf 1//1 2//1 3//1\nf 01//01 -2//-1 +4//1\n")
    assert len(mesh.vertices) == 4


def test_normals_come_out_with_unit_length(load):
    mesh = load(SQUARE + "vn 0 3 4\nvn 0 0 1e-200\nf 1//1 2//2 3//2\n")
    assert np.allclose(mesh.normals, [(0, 0.6, 0.8), (0, 0, 1), (0, 0, 1)], rtol=0, atol=2.0**-52)


def test_corners_without_normal_in_a_file_that_has_some_get_generated_ones(load):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 0 1 0\nf 1 2 3\nf 1//1 3//1 4//1\n"
    mesh = load(text)
    generated = vertex_normals(mesh.vertices[[0, 2, 3, 5]], np.array([(0, 1, 2), (0, 2, 3)], np.int32))
    assert np.array_equal(mesh.normals[mesh.faces[0]], generated[:3])
    assert np.array_equal(mesh.normals[mesh.faces[1]], [(0, 1, 0)] * 3)


def test_every_corner_of_a_file_has_its_own_normal_or_that_generated_at_its_vertex(load):
    rng = np.random.default_rng(7)
    points, normals = rng.normal(size=(9, 3)), np.eye(3)
    faces = np.array([rng.permutation(9)[:3] for _ in range(24)])
    named = rng.integers(-1, 3, size=faces.shape)  # -1: none
    lines = [f"v {' '.join(map(repr, point))}" for point in points.tolist()]
    lines += [f"vn {' '.join(map(repr, normal))}" for normal in normals.tolist()]
    for face, of_face in zip((faces + 1).tolist(), (named + 1).tolist(), strict=True):
        corners = (f"{v}//{n}" if n else f"{v}" for v, n in zip(face, of_face, strict=True))
        lines.append(f"f {' '.join(corners)}")
    mesh = load("\n".join(lines))
    generated = vertex_normals(points, faces.astype(np.int32))
    expected = np.where((named < 0)[..., None], generated[faces], normals[named])
    assert np.allclose(mesh.normals[mesh.faces], expected, rtol=0, atol=2.0**-50)


def test_a_mesh_is_kept_until_its_file_has_another_time_or_size(tmp_path):
    path = tmp_path / "mesh.obj"

    def mesh_of(face, time):
        path.write_text(f"{SQUARE}f {face}\n")
        os.utime(path, ns=(time, time))
        return MeshFile(file=str(path)).mesh()

    time = 1_700_000_000_000_000_000  # ns
    first = mesh_of("1 2 3", time)
    assert mesh_of("1 2 3", time) is first
    assert np.array_equal(mesh_of("2 3 4", time + 1000).faces, [(1, 2, 3)])  # within the same second
    assert len(mesh_of("1 2 3 4", time + 1000).faces) == 2


def test_corners_without_uv_in_a_file_that_has_some_get_zeros(load):
    mesh = load(SQUARE + "vt .5 .5\nf 1/1 2 3/1\n")
    assert np.array_equal(mesh.uv, [(0.5, 0.5), (0, 0), (0.5, 0.5)])


@pytest.mark.parametrize(
    "text",
    [
        SQUARE.replace("\n", "\r\n") + "f 1 2 3\r\n",
        SQUARE.replace("\n", "\r") + "f 1 2 3",
        SQUARE.replace(" ", "\t") + "\tf\t1  2\t3\t",
        SQUARE + "f 1 \\\n 2 \\\r\n 3",
        "# caf\xe9 \\\n" + SQUARE + "\n\no a\ng b # c\ns off\nusemtl x_1\nmtllib m.mtl\nl 1 2\nf 1 2 3 # 4",
        "\ufeff" + SQUARE + "f 1 2 3",
        "v 0 0 0 1\nv 1 0 0 0.5 0.5 0.5\nv 1e0 1.0 -0 1\nv +0 1. 0\nf 1// 2/ 3",
        "f 1 2 3\n" + SQUARE,
    ],
    ids=["crlf", "cr", "tabs", "continuation", "comments and groups", "mark", "w and colours", "faces first"],
)
def test_ways_to_write_the_same_triangle(load, text):
    mesh = load(text.encode("utf-8"))
    assert np.array_equal(mesh.vertices, SQUARE_VERTICES) and np.array_equal(mesh.faces, [(0, 1, 2)])


def test_objects_of_a_file_are_merged(load):
    mesh = load("o one\n" + SQUARE + "f 1 2 3\no two\nv 0 0 1\nv 1 0 1\nv 0 1 1\nf 5 6 7\n")
    assert np.array_equal(mesh.faces, [(0, 1, 2), (4, 5, 6)])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (SQUARE + "f 1 2\n", ":5: a face needs at least 3 vertices, got 2"),
        (SQUARE + "f 1 2 5\n", ":5: v of a corner must be 1 to 4 or -4 to -1, got '5'"),
        (SQUARE + "f 1 2 3\nf 0 1 2\n", ":6: v of a corner .* got '0'"),
        (SQUARE + "f -1 -2 -5\n", ":5: v of a corner .* got '-5'"),
        (SQUARE + "f 1/1 2/1 3/1\n", ":5: vt of a corner must be none, as there is no vt, got '1'"),
        (SQUARE + "vn 0 0 1\nf 1//1 2//1 3//2\n", ":6: vn of a corner .* got '2'"),
        (SQUARE + "f 1 2 99999999999999999999999\n", ":5: v of a corner .* got '9"),
        (SQUARE + "f 1 2 3/1/1/1\n", ":5: expected a corner v, v/vt"),
        (SQUARE + "f 1 2 /1\n", ":5: expected a corner v, v/vt"),
        (SQUARE + "f 1 2 x\n", ":5: expected a whole number as v of a corner, got 'x'"),
        (SQUARE + "f 1 2 3_0\n", ":5: expected a corner"),
        (SQUARE + "f 1 2 3.0\n", ":5: expected a whole number .* got '3.0'"),
        (SQUARE + "vt inf 0\nf 1/1 2/1 3/1\n", ":5: vt must be finite"),
        (SQUARE + "vn 0 nan 0\nf 1//1 2//1 3//1\n", ":5: vn must be finite"),
        (SQUARE + "vn 0 0 0\nf 1//1 2//1 3//1\n", ": the normal of vertex 0 must have a direction"),
        ("v 1 2\nf 1 1 1\n", ":1: v needs 3 numbers, got 2"),
        ("v 1 2 three\n", ":1: expected numbers, got '1 2 three'"),
        ("v 1 2 1_0\n", ":1: expected numbers, got '1 2 1_0'"),
        ("v 1 2 \\\n\n\nv 1 2 x\n", ":1: v needs 3 numbers, got 2"),
        ("# one\\\nv 1 2 x\n", ":2: expected numbers"),
        (SQUARE + "ff 1 2 3\n", r":5: expected an OBJ statement \(v, vt, vn, f, ...\), got 'ff'"),
        (b"\x00\xff\xfe\x80", r":1: expected an OBJ statement .*\\x00"),
        (SQUARE, ": the mesh has no faces: expected at least one, got 4 vertices only"),
        ("# nothing\n", ": the mesh has no faces"),
        ("", r": the file is empty \(0 bytes\)"),
    ],
)
def test_a_broken_file_is_an_error_with_its_line(load, text, words):
    with pytest.raises(SceneError, match=r"mesh\.obj" + words):
        load(text)


def test_a_missing_file_is_missing(tmp_path):
    with pytest.raises(FileMissing, match=r"no\.obj: cannot read this mesh file: No such file"):
        load_mesh(tmp_path / "no.obj")


def test_a_folder_is_not_a_mesh_file(tmp_path):
    folder = tmp_path / "folder.obj"
    folder.mkdir()
    with pytest.raises(FileMissing, match="cannot read this mesh file"):
        load_mesh(folder)


def test_a_path_that_cannot_exist_is_missing():
    with pytest.raises(FileMissing, match="cannot read this mesh file"):
        load_mesh("a\0b.obj")


@pytest.mark.parametrize(("name", "ending"), [("ball.3ds", ".3ds"), ("ball", "")])
def test_an_unknown_format_is_an_error_that_names_the_known_ones(tmp_path, name, ending):
    with pytest.raises(
        SceneError, match=f"unknown mesh format '{ending}': expected .obj, .ply, .stl, .off, .glb or .gltf"
    ):
        load_mesh(tmp_path / name)


def test_the_ending_may_be_in_capitals(tmp_path):
    path = tmp_path / "MESH.OBJ"
    path.write_text(SQUARE + "f 1 2 3\n")
    assert len(load_mesh(path).faces) == 1


def test_the_numbers_are_the_nearest_float64(load):
    numbers = [0.1, 1 / 3, -math.pi * 1e-300]
    mesh = load(f"v {numbers[0]!r} {numbers[1]!r} {numbers[2]!r}\nf 1 1 1\n")
    assert np.array_equal(mesh.vertices, [numbers])


@pytest.mark.parametrize("facets", [0, 1, 3, 300])
def test_a_binary_stl_file_has_84_bytes_and_50_for_each_facet_and_a_text_any_number(facets):
    size = 84 + 50 * facets
    binary = b"solid but binary".ljust(80) + facets.to_bytes(4, "little") + bytes(50 * facets)
    assert len(binary) == size
    _check_stl_size(binary, "x.stl")
    for wrong in (binary[:-1], binary + b"\0"):
        with pytest.raises(SceneError, match=rf"^x.stl: binary STL: expected {size} bytes, .* got {len(wrong)};"):
            _check_stl_size(wrong, "x.stl")
    _check_stl_size(b"solid a\n" + b"facet normal 0 0 1\n" * facets + b"facet", "x.stl")


def test_a_stl_file_is_loaded_after_its_size_is_checked(tmp_path):
    path = tmp_path / "x.STL"
    path.write_bytes(bytes(80) + (3).to_bytes(4, "little") + bytes(50 * 2))
    pytest.importorskip("trimesh")
    with pytest.raises(SceneError, match="binary STL: expected 234 bytes"):
        load_mesh(path)


@pytest.mark.parametrize(("name", "data"), [("x.off", b"OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n"), ("x.stl", bytes(84))])
def test_a_file_of_another_format_that_has_no_faces_is_refused(tmp_path, name, data):
    pytest.importorskip("trimesh")
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(SceneError) as caught:
        load_mesh(path)
    assert str(caught.value) == f"{path}: the mesh has no faces: expected at least one triangle"


QUAD = b"OFF\n5 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n.5 2 1\n4 0 1 2 3\n3 0 3 4\n"


@pytest.mark.parametrize(
    "data",
    [
        QUAD,
        QUAD.replace(b"OFF\n", b"OFF "),
        QUAD.replace(b"OFF\n", b"# a comment\n\nCOFF # another\n").replace(b"1 1 0\n", b"1 1 0 255 0 0 255\n"),
        QUAD.replace(b"\n", b"\r\n").replace(b"3 0 3 4", b"3 0 3 4 0.5 0.5 0.5"),
    ],
    ids=["plain", "counts beside the header", "colours and comments", "other line ends"],
)
def test_polygons_of_an_off_file_are_fans_in_the_order_of_the_file(data):
    mesh = parse_off(data, "x.off")
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4]] and mesh.faces.dtype == np.int32
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 2, 1]]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (b"OFF", b"BYU", "x.off: expected an OFF file in text"),
        (b"OFF", b"OFF BINARY", "x.off: expected an OFF file in text"),
        (b"5 2 0", b"5", "x.off:2: expected 2 numbers, got '5'"),
        (b"5 2 0", b"5 3 0", "x.off: expected lines of 5 vertices and 3 faces, got 7"),
        (b"5 2 0", b"-5 2 0", "x.off: expected lines of -5 vertices"),
        (b"1 1 0", b"1 one 0", "x.off:5: expected 3 numbers, got '1 one 0'"),
        (b"1 1 0", b"1 1", "x.off:5: expected 3 numbers, got '1 1'"),
        (b"1 1 0", b"1 1_0 0", "x.off:5: expected 3 numbers, got '1 1_0 0'"),
        (b"3 0 3 4", b"3 0 3.0 4", "x.off:9: expected 4 numbers, got '3 0 3.0 4'"),
        (b"4 0 1 2 3", b"4 0 1 2", "x.off:8: expected 5 numbers, got '4 0 1 2'"),
        (b"3 0 3 4", b"2 0 3", "x.off:9: expected at least 3 of the vertices 0 to 4, got [0, 3]"),
        (b"3 0 3 4", b"3 0 3 5", "x.off:9: expected at least 3 of the vertices 0 to 4, got [0, 3, 5]"),
        (b"3 0 3 4", b"0", "x.off:9: expected at least 3 of the vertices 0 to 4, got []"),
    ],
)
def test_a_broken_off_file_is_refused_with_its_line(old, new, says):
    with pytest.raises(SceneError) as caught:
        parse_off(QUAD.replace(old, new, 1), "x.off")
    assert str(caught.value).startswith(says)


def test_tables_too_large_for_an_integer_key_are_joined_to_the_same_mesh():
    """2^21 positions, normals and uv have more combinations than an int64 counts."""
    rng, count = np.random.default_rng(17), 2**21
    small = [rng.normal(size=(9, width)) for width in (3, 2, 3)]
    corners = np.column_stack([rng.integers(0, 9, 60), rng.integers(-1, 9, 60), rng.integers(-1, 9, 60)])
    sizes = np.full(20, 3)
    expected = join_table(*small, corners, sizes)
    large = [np.concatenate([each, np.zeros((count - 9, each.shape[1]))]) for each in small]
    for found, right in zip(join_table(*large, corners, sizes), expected, strict=True):
        assert np.array_equal(found, right)

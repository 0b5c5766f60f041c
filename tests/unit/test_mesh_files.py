"""Mesh files: OBJ, PLY, STL, OFF and glTF, whole and broken."""

import json
import math
import os
import struct

import numpy as np
import pytest
from ply_files import ENCODINGS, INDICES, XYZ, ply, ply_mesh

from caster.description.errors import FileMissing, SceneError
from caster.geometry.mesh_files import GLB_HEADER, _rotations_as_matrices, load_mesh
from caster.geometry.mesh_files.ply import parse_off
from caster.geometry.triangle_mesh import vertex_normals
from caster.shapes.mesh import Mesh

trimesh = pytest.importorskip("trimesh")


@pytest.fixture
def load(tmp_path):
    def load_as(name, data):
        path = tmp_path / name
        path.write_bytes(data if isinstance(data, bytes) else data.encode())
        return load_mesh(path)

    return load_as


@pytest.fixture
def refused(load):
    """The file is an error that says so."""

    def refused_as(name, data, words):
        with pytest.raises(SceneError, match=words):
            load(name, data)

    return refused_as


# ---- OBJ

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
CORNERS = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


def test_vertices_keep_their_order_and_polygons_become_fans_around_their_first_corner(load):
    mesh = load("a.obj", SQUARE + "v 0 .5 0\nv 9 9 9\nf 3 2 1\nf 1 2 3 4 5\nf 3 4 5\n")
    assert mesh.vertices.tolist() == [[float(x) for x in row] for row in [*CORNERS, (0, 0.5, 0), (9, 9, 9)]]
    assert mesh.faces.tolist() == [[2, 1, 0], [0, 1, 2], [0, 2, 3], [0, 3, 4], [2, 3, 4]]
    assert mesh.normals is None and mesh.uv is None
    assert mesh.vertices.dtype == np.float64 and mesh.faces.dtype == np.int32


def test_negative_indices_count_back_in_their_own_lists_from_their_line(load):
    assert load("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 5 5 5\nf -4 -1 2\n").faces.tolist() == [
        [0, 1, 2],
        [0, 3, 1],
    ]
    lists = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvn 0 0 1\n"
    found = load("a.obj", lists + "f -3/-2/-1 -2/-1/-1 -1/-2/-1\n")
    for ours, expected in zip(found, load("b.obj", lists + "f 1/1/1 2/2/1 3/1/1\n"), strict=True):
        assert np.array_equal(ours, expected)


def test_a_corner_with_another_normal_or_uv_is_a_vertex_of_its_own_in_the_order_of_the_file(load):
    mesh = load("a.obj", SQUARE + "vn 0 0 1\nvn 1 0 0\nf 1//2 2//1 3//1\nf 1//1 03//01 4//-2\n")
    assert np.array_equal(mesh.vertices, [CORNERS[k] for k in (0, 0, 1, 2, 3)])
    assert np.array_equal(mesh.normals, [(0, 0, 1), (1, 0, 0), (0, 0, 1), (0, 0, 1), (0, 0, 1)])
    assert np.array_equal(mesh.faces, [(1, 2, 3), (0, 3, 4)])


def test_v_of_uv_is_turned_over_and_corners_without_uv_have_zeros(load):
    mesh = load("a.obj", SQUARE + "vt 0.25 0.75\nvt 1\nvt 0 0 0.5\nf 1/1 2/2 3/3\nf 1/1 3/3 4\n")
    assert np.array_equal(mesh.uv, [(0.25, 0.25), (1, 1), (0, 1), (0, 0)]) and mesh.normals is None


def test_every_corner_has_its_own_normal_of_unit_length_or_that_generated_at_its_vertex(load):
    rng = np.random.default_rng(7)
    points, normals = rng.normal(size=(9, 3)), np.diag([1.0, 3.0, 1e-200])
    faces = np.array([rng.permutation(9)[:3] for _ in range(24)])
    named = rng.integers(-1, 3, size=faces.shape)  # -1: none
    lines = [f"v {' '.join(map(repr, point))}" for point in points.tolist()]
    lines += [f"vn {' '.join(map(repr, normal))}" for normal in normals.tolist()]
    for face, of_face in zip((faces + 1).tolist(), (named + 1).tolist(), strict=True):
        lines.append("f " + " ".join(f"{v}//{n}" if n else f"{v}" for v, n in zip(face, of_face, strict=True)))
    mesh = load("a.obj", "\n".join(lines))
    generated = vertex_normals(points, faces.astype(np.int32))
    expected = np.where((named < 0)[..., None], generated[faces], np.eye(3)[named])
    assert np.allclose(mesh.normals[mesh.faces], expected, rtol=0, atol=2.0**-50)


def test_numbers_of_an_obj_keep_all_digits(load):
    numbers = [[0.1, 1 / 3, -math.pi * 1e-300], [1.0 + 2.0**-52, 5e-324, 123456789.123456789]]
    lines = [f"v {x!r} {y:.17e} {z!r}" for x, y, z in numbers]
    assert load("a.obj", "\n".join([*lines, "f 1 2 1"])).vertices.tolist() == numbers


@pytest.mark.parametrize(
    "text",
    [
        SQUARE.replace("\n", "\r\n") + "f 1 2 3\r\n",
        SQUARE.replace("\n", "\r") + "f 1 2 3",
        SQUARE.replace(" ", "\t") + "\tf\t1  2\t3\t",
        SQUARE + "f 1 \\\n 2 \\\r\n 3",
        "# caf\xe9 \\\n" + SQUARE + "\n\no a\ng b # c\ns off\nusemtl x_1\nmtllib m.mtl\nl 1 2\nf 1 2 3 # 4",
        "\ufeff" + SQUARE + "fo 1 2 3",
        "v 0 0 0 1\nv 1 0 0 0.5 0.5 0.5\nv 1e0 1.0 -0 1\nv +0 1. 0\nf 1// 2/ 3",
        "f 1 2 3\n" + SQUARE,
    ],
    ids=["crlf", "cr", "tabs", "continuation", "comments and groups", "mark", "w and colours", "faces first"],
)
def test_ways_to_write_the_same_triangle(load, text):
    mesh = load("MESH.OBJ", text.encode("utf-8"))
    assert np.array_equal(mesh.vertices, CORNERS) and np.array_equal(mesh.faces, [(0, 1, 2)])


BROKEN_OBJ = [
    (SQUARE + "f 1 2\n", ":5: a face needs at least 3 vertices, got 2"),
    (SQUARE + "f 1 2 5\n", ":5: v of a corner must be 1 to 4 or -4 to -1, got '5'"),
    (SQUARE + "f 1 2 3\nf 0 1 2\n", ":6: v of a corner .* got '0'"),
    (SQUARE + "f 1/1 2/1 3/1\n", ":5: vt of a corner must be none, as there is no vt, got '1'"),
    (SQUARE + "f 1 2 3/1/1/1\n", ":5: expected a corner v, v/vt"),
    (SQUARE + "f 1 2 3_0\n", ":5: expected a corner"),
    (SQUARE + "f 1 2 3.0\n", ":5: expected a whole number as v of a corner, got '3.0'"),
    (SQUARE + "vt inf 0\nf 1/1 2/1 3/1\n", ":5: vt must be finite"),
    (SQUARE + "vn 0 nan 0\nf 1//1 2//1 3//1\n", ":5: vn must be finite"),
    (SQUARE + "vn 0 0 0\nf 1//1 2//1 3//1\n", ": the normal of vertex 0 must have a direction"),
    ("v 1 2 three\n", ":1: expected numbers, got '1 2 three'"),
    ("v 1 2 1_0\n", ":1: expected numbers, got '1 2 1_0'"),
    ("# one\\\nv 1 2 x\n", ":2: expected numbers"),
    (SQUARE + "ff 1 2 3\n", r":5: expected an OBJ statement \(v, vt, vn, f, ...\), got 'ff'"),
    (b"\x00\xff\xfe\x80", r":1: expected an OBJ statement .*\\x00"),
    (SQUARE, ": the mesh has no faces: expected at least one, got 4 vertices only"),
    ("", r": the file is empty \(0 bytes\)"),
]


@pytest.mark.parametrize(("text", "words"), BROKEN_OBJ)
def test_a_broken_obj_is_an_error_with_its_line(refused, text, words):
    refused("a.obj", text, r"a\.obj" + words)


# ---- PLY

TRIANGLES = [(0, 1, 2), (0, 2, 3)]
POINTS = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.5)]


def square(encoding="ascii", polygons=TRIANGLES, vertices=POINTS, **options):
    return ply_mesh(encoding, vertices, polygons, **options)


@pytest.fixture(params=ENCODINGS)
def encoding(request):
    return request.param


@pytest.mark.parametrize(
    ("polygons", "triangles"),
    [
        (TRIANGLES, TRIANGLES),
        ([(0, 1, 2, 3), (3, 2, 1, 0)], [(0, 1, 2), (0, 2, 3), (3, 2, 1), (3, 1, 0)]),
        ([(0, 1, 2), (0, 1, 2, 3), (3, 2, 1)], [(0, 1, 2), (0, 1, 2), (0, 2, 3), (3, 2, 1)]),
    ],
    ids=["triangles", "quads", "mixed"],
)
def test_vertices_and_polygons_of_a_ply_come_back_in_their_order(load, encoding, polygons, triangles):
    mesh = load("a.ply", square(encoding, polygons))
    assert np.array_equal(mesh.vertices, POINTS) and np.array_equal(mesh.faces, triangles)
    assert mesh.normals is None and mesh.uv is None
    assert mesh.vertices.dtype == np.float64 and mesh.faces.dtype == np.int32


@pytest.mark.parametrize(
    ("count", "index"), [("uchar", "char"), ("int", "ushort"), ("uint32", "uint"), ("int8", "uint8")]
)
def test_any_whole_number_type_will_do_for_indices(load, encoding, index, count):
    faces = ("face", [f"list {count} {index} vertex_index"], [(t,) for t in TRIANGLES])
    assert np.array_equal(load("a.ply", ply(encoding, ("vertex", XYZ, POINTS), faces)).faces, TRIANGLES)


def test_numbers_keep_all_digits_of_their_type(load, encoding):
    row = (0.1, 1 / 3, 1e-300)
    faces = ("face", INDICES, [((0, 1, 2),)])
    double = ply(encoding, ("vertex", ["double x", "float64 y", "double z"], [row] * 3), faces)
    assert np.array_equal(load("a.ply", double).vertices, [row] * 3)
    single = load("a.ply", square(encoding, [(0, 1, 2)], [(0.1, 0.2, 0.3)] * 3)).vertices
    rounded = np.float64(np.float32([(0.1, 0.2, 0.3)] * 3))
    assert np.array_equal(single, [(0.1, 0.2, 0.3)] * 3 if encoding == "ascii" else rounded)


@pytest.mark.parametrize("names", [("u", "v"), ("s", "t"), ("texture_u", "texture_v")])
def test_normals_and_uv_are_read_by_name_wherever_they_stand(load, encoding, names):
    u, v = names
    properties = [f"float {v}", "float nz", "float y", "uchar red", "float ny", "float z", "double nx"]
    properties += ["float x", f"float {u}"]
    rows = [(0.25, 4.0, y, 255, 3.0, z, 0.1, x, 0.75) for x, y, z in POINTS]
    mesh = load("a.ply", ply(encoding, ("vertex", properties, rows), ("face", INDICES, [(t,) for t in TRIANGLES])))
    assert np.array_equal(mesh.vertices, POINTS)
    unit = np.array([0.1, 3.0, 4.0]) / np.sqrt(25.01)
    assert np.allclose(mesh.normals, [unit] * 4, rtol=0, atol=2.0**-52)
    assert np.array_equal(mesh.uv, [(0.75, 0.25)] * 4)  # not turned over


@pytest.mark.parametrize("many", [[(1, 2), (3, 4)], [(1,), ()], []], ids=["equal lists", "ragged lists", "no rows"])
def test_unknown_elements_and_properties_are_passed_over(load, encoding, many):
    strange = ("strange", ["list uchar short things", "double one"], [(things, 0.5) for things in many])
    face = ["int flags", "list uchar float weights", *INDICES, "float area"]
    rows = [(7, (0.5,) * k, polygon, 1.5) for k, polygon in enumerate(TRIANGLES)]
    vertex = ("vertex", [*XYZ, "list uint uchar beside"], [(*v, (1, 2)) for v in POINTS])
    data = ply(encoding, strange, ("face", face, rows), ("nothing", [], []), ("camera", ["char c"], [(1,)]), vertex)
    mesh = load("a.ply", data)
    assert np.array_equal(mesh.vertices, POINTS) and np.array_equal(mesh.faces, TRIANGLES)


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"], ids=["lf", "crlf", "cr"])
def test_any_line_ending_will_do_in_the_header(load, encoding, newline):
    """The first float's bytes are line ends themselves: they belong to the body."""
    x = struct.unpack("<f", b"\n\n\r\n")[0]
    extra = ["comment made by hand", "obj_info none", ""]
    mesh = load("a.ply", square(encoding, vertices=[(x, 0.0, 0.0), *POINTS[1:]], newline=newline, extra=extra))
    assert np.array_equal(mesh.faces, TRIANGLES) and mesh.vertices[0, 0] == x


def test_a_truncated_ply_is_an_error_at_every_byte(refused, encoding):
    """Down to the last number of ascii, which may lose digits and stay a number."""
    whole = square(encoding)
    for length in range(1, len(whole) - (2 if encoding == "ascii" else 0)):
        refused("a.ply", whole[:length], r"a\.ply:")


def test_truncation_states_how_much_is_there_and_takes_no_memory(refused):
    data = square("binary_little_endian")
    for broken, words in (
        (data[:-1], "expected 2 rows of element 'face', got 1 whole ones"),
        (data[: data.index(b"end_header\n") + 11 + 47], "expected 4 rows of element 'vertex', got 3 whole ones"),
        (square()[:-9], "expected 2 rows of element 'face', got 1 whole ones"),
        (data.replace(b"vertex 4", b"vertex 4000000000000"), "expected 4000000000000 rows"),
        (data.replace(b"list uchar", b"list uint "), "expected 2 rows of element 'face'"),
    ):
        refused("a.ply", broken, f"truncated: {words}")
    refused("a.ply", data + b"\n", "expected the end of the file after the last element, got 1 more bytes")
    signed = square("binary_big_endian", [(0, 1, 2)]).replace(b"uchar int", b"char int")
    negative = r"row 0 of element 'face': expected a length >= 0 .*'vertex_indices', got -1"
    refused("a.ply", signed[:-13] + b"\xff" + signed[-12:], negative)


@pytest.mark.parametrize("index", [4, -1, 2**31 - 1])
def test_an_index_out_of_range_is_an_error_that_names_the_polygon(refused, encoding, index):
    where = ":15" if encoding == "ascii" else ""
    words = rf"a\.ply{where}: face 1 must join vertices 0 to 3 \(the file has 4\), got "
    refused("a.ply", square(encoding, [(0, 1, 2, 3), (0, 1, index)]), words)
    faces = ("face", ["list uchar uint vertex_index"], [((0, 1, 0xFFFFFFFF),)])
    refused("a.ply", ply(encoding, ("vertex", XYZ, POINTS), faces), r"face 0 .*got 4\.29497e\+09")  # which is no -1


@pytest.mark.parametrize(
    ("elements", "words"),
    [
        ([("vertex", XYZ, POINTS)], "expected elements vertex and face, got no 'face'"),
        ([("face", INDICES, [])], "expected elements vertex and face, got no 'vertex'"),
        ([("vertex", XYZ, POINTS), ("face", INDICES, [])], "the mesh has no faces"),
        ([("vertex", XYZ, POINTS), ("face", INDICES, [((0, 1, 2),), ((0, 1),)])], "face 1 needs at least 3 .*, got 2"),
        ([("vertex", XYZ[:2], []), ("face", INDICES, [])], "expected the properties x, y, z of .*'vertex'.*got x, y"),
        ([("vertex", [*XYZ, "float nx"], []), ("face", INDICES, [])], "expected the properties nx, ny, nz"),
        (
            [("vertex", [*XYZ[:2], "list uchar float z"], []), ("face", INDICES, [])],
            "a number each, got x, y, z, a list",
        ),
        ([("vertex", XYZ, []), ("face", ["int vertex_indices"], [])], "expected a list vertex_indices or"),
        ([("vertex", XYZ, []), ("face", ["list uchar int corners"], [])], "expected a list .*got corners"),
        (
            [
                ("vertex", [*XYZ, "float nx", "float ny", "float nz"], [(*p, 1.0, math.nan, 2.0) for p in POINTS]),
                ("face", INDICES, []),
            ],
            r"nx, ny, nz of vertex 0 must be finite numbers, got \(1, nan, 2\)",
        ),
    ],
)
def test_what_a_mesh_needs_must_be_there(refused, encoding, elements, words):
    refused("a.ply", ply(encoding, *elements), words)


def test_a_vertex_that_is_not_finite_is_kept_for_its_faces_to_be_left_out(load, encoding):
    mesh = load("a.ply", square(encoding, vertices=[POINTS[0], (0.0, math.nan, 0.0), *POINTS[2:]]))
    assert np.argwhere(np.isnan(mesh.vertices)).tolist() == [[1, 1]]


BROKEN_PLY = [
    (b"ply\n", b"plx\n", ":1: PLY header: expected the line 'ply'"),
    (b"format ascii 1.0", b"format utf8 1.0", ":2: PLY header: expected format ascii, .* got 'format utf8"),
    (b"element vertex", b"format ascii 1.0\nelement vertex", ":3: PLY header: expected one line with the format"),
    (b"format ascii 1.0\n", b"", ":2: PLY header: expected one line with the format, before all elements"),
    (b"vertex 4", b"vertex -4", ":3: PLY header: expected .*element NAME ROWS.*got 'element vertex -4'"),
    (b"vertex 4\n", b"vertex 4\nelement vertex 4\n", ":4: PLY header: expected each element once"),
    (b"float y", b"float x", ":5: PLY header: expected each property of an element once, got 'property float x'"),
    (b"list uchar int", b"list float int", ":8: PLY header: expected .*got 'property list float int"),
    (b"element face", b"element bare 2\nelement face", ": PLY header: expected properties of element 'bare'"),
    (b"end_header", b"end", ":9: PLY header: expected .* or end_header .*got 'end'"),
    (b"1.0 1.0 0.0", b"1.0 1.0 O.0", ":12: expected numbers, got '1.0 1.0 O.0'"),
    (b"1.0 1.0 0.0", b"1.0 1.0", ":12: row 2 of element 'vertex': expected 3 numbers, got 2"),
    (b"3 0 2 3", b"3 0 2", ":15: truncated"),
    (b"3 0 2 3", b"-3 0 2 3", ":15: row 1 of element 'face': expected a length >= 0 of list .* got -3"),
    (b"3 0 2 3", b"3 0 2 3\n3 0 1 2", ":16: expected the end of the file .* got 1 more rows"),
    (b"3 0 2 3", b"3 0 2 1.5", r":15: face 1 must join vertices 0 to 3 .*got 1\.5"),
]


@pytest.mark.parametrize(("old", "new", "words"), BROKEN_PLY)
def test_a_broken_ascii_ply_is_an_error_with_its_line(refused, old, new, words):
    whole = square()
    assert whole.count(old) == 1
    refused("a.ply", whole.replace(old, new), r"a\.ply" + words)


# ---- OFF and STL

OFF = b"OFF\n5 3 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n.5 2 1\n3 0 3 4\n4 0 1 2 3\n3 4 3 2\n"


@pytest.mark.parametrize(
    "data",
    [
        OFF,
        OFF.replace(b"OFF\n", b"OFF "),
        OFF.replace(b"OFF\n", b"# a comment\n\nCOFF # another\n").replace(b"1 1 0\n", b"1 1 0 255 0 0 255\n"),
        OFF.replace(b"\n", b"\r\n").replace(b"3 0 3 4", b"3 0 3 4 0.5 0.5 0.5"),
    ],
    ids=["plain", "counts beside the header", "colours and comments", "other line ends"],
)
def test_polygons_of_an_off_file_are_fans_in_the_order_of_the_file(data):
    mesh = parse_off(data, "x.off")
    assert mesh.faces.tolist() == [[0, 3, 4], [0, 1, 2], [0, 2, 3], [4, 3, 2]] and mesh.faces.dtype == np.int32
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 2, 1]]
    assert mesh.normals is None and mesh.uv is None


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (b"OFF", b"BYU", "x.off: expected an OFF file in text"),
        (b"5 3 0", b"5", "x.off:2: expected numbers of vertices and faces, got '5'"),
        (b"5 3 0", b"5 4 0", "x.off: truncated: expected 4 rows of element 'face', got 3 whole ones"),
        (b"1 1 0", b"1 one 0", "x.off:5: expected numbers, got '1 one 0'"),
        (b"4 0 1 2 3", b"4 0 1 2", "x.off:9: row 1 of element 'face': expected 5 numbers, got 4"),
        (b"3 0 3 4", b"2 0 3", "x.off:8: face 0 needs at least 3 vertices, got 2"),
        (b"3 0 3 4", b"3 0 3 5", "x.off:8: face 0 must join vertices 0 to 4 (the file has 5), got 5"),
    ],
)
def test_a_broken_off_file_is_refused_with_its_line(old, new, says):
    with pytest.raises(SceneError) as caught:
        parse_off(OFF.replace(old, new, 1), "x.off")
    assert str(caught.value).startswith(says)


STL_CORNERS = np.array([[(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(1, 0, 0), (1, 1, 0.5), (0, 1, 0)]], np.float32)


def stl(kind):
    if kind == "text":
        facets = ("".join(f" vertex {x} {y} {z}\n" for x, y, z in facet) for facet in STL_CORNERS.tolist())
        body = "".join(f"facet normal 0 0 1\nouter loop\n{facet}endloop\nendfacet\n" for facet in facets)
        return f"solid a\n{body}endsolid a\n".encode()
    facets = b"".join(struct.pack("<12fH", 7, 7, 7, *facet.ravel(), 5) for facet in STL_CORNERS)
    return b"solid but binary".ljust(80) + struct.pack("<I", len(STL_CORNERS)) + facets


@pytest.mark.parametrize("kind", ["text", "binary"])
def test_facets_of_an_stl_have_three_vertices_each_in_their_order_and_no_normals(load, kind):
    mesh = load("a.stl", stl(kind))
    assert np.array_equal(mesh.vertices[mesh.faces], STL_CORNERS) and len(mesh.vertices) == 6
    assert mesh.normals is None and mesh.uv is None


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("a.stl", stl("binary")[:-1], "binary STL: expected 184 bytes, .* got 183;"),
        ("a.stl", stl("binary") + b"\0", "binary STL: expected 184 bytes, .* got 185;"),
        ("a.stl", bytes(84), "the mesh has no faces"),
        ("a.stl", b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0", "the mesh has no faces"),
        ("a.off", b"OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n", "the mesh has no faces"),
        ("a.glb", b"glTF but no more", "not a usable GLB file"),
        ("a.gltf", b"{}", "not a usable GLTF file|the mesh has no faces"),
        ("a.3ds", b"M", "unknown mesh format '.3ds': expected .obj, .ply, .stl, .off, .glb or .gltf"),
    ],
)
def test_a_broken_file_of_another_format_is_an_error_with_its_reason(refused, name, data, words):
    refused(name, data, f"{name}: ({words})")


# ---- glTF


def glb(change=lambda nodes: None):
    """A box and its mirror image below two nodes, with the JSON changed."""
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box(), geom_name="box", node_name="box")
    data = scene.export(file_type="glb")
    magic, version, _, size, chunk = GLB_HEADER.unpack_from(data)
    start = GLB_HEADER.size
    content = json.loads(data[start : start + size])
    mesh = next(node["mesh"] for node in content["nodes"] if "mesh" in node)
    content["nodes"] = [
        {"children": [1, 2], "translation": [1, 2, 3], "rotation": [0.1, 0.3, -0.05, 0.9], "scale": [2, 2, 2]},
        {"mesh": mesh, "rotation": [0.2, 0.6, -0.1, 0.8], "scale": [1, 1, -1]},
        {"mesh": mesh, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1e-9, 0, 0, 1]},
    ]
    content["scenes"] = [{"nodes": [0]}]
    change(content["nodes"])
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    rest = data[start + size :]
    return GLB_HEADER.pack(magic, version, start + len(text) + len(rest), len(text), chunk) + text + rest


def test_nodes_of_a_gltf_place_their_meshes_with_the_outside_outside(load, tmp_path):
    assert b"rotation" not in _rotations_as_matrices(glb(), "glb")
    mesh = load("a.glb", glb())
    found = trimesh.load_scene(str(tmp_path / "a.glb"), process=False, maintain_order=True).to_mesh()
    assert np.array_equal(mesh.faces, found.faces) and len(mesh.vertices) == len(found.vertices)
    assert mesh.vertices == pytest.approx(np.asarray(found.vertices), abs=1e-8)  # trimesh drops shifts below that
    half = len(mesh.faces) // 2
    for part in (mesh.faces[:half], mesh.faces[half:]):
        corners = mesh.vertices[part]
        outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert ((corners[:, 0] - corners.mean(axis=(0, 1))) * outward).sum(axis=1).min() > 0.0


@pytest.mark.parametrize("rotation", [[0, 0, 0, 0], [0, 0, 1], ["x", 0, 0, 1], None, [1e999, 0, 0, 1]])
def test_a_broken_rotation_is_no_traceback(load, rotation):
    try:
        assert len(load("a.glb", glb(lambda nodes: nodes[1].update(rotation=rotation))).faces) == 24
    except SceneError as error:
        assert "a.glb" in str(error)


def test_vertices_and_faces_of_a_gltf_are_those_of_the_file_also_where_they_meet_or_are_unused(load):
    points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0), (1, 1, 0.5), (9, 9, 9)]
    whole = trimesh.Trimesh(points, [(0, 1, 2), (3, 4, 2)], process=False)
    mesh = load("a.glb", trimesh.Scene(whole).export(file_type="glb"))
    assert np.array_equal(mesh.vertices, points) and np.array_equal(mesh.faces, [(0, 1, 2), (3, 4, 2)])
    assert mesh.normals is None and mesh.uv is None


# ---- files


def test_files_that_cannot_be_read_are_missing(tmp_path):
    (tmp_path / "folder.obj").mkdir()
    for path in (tmp_path / "no.obj", tmp_path / "folder.obj", "a\0b.obj"):
        with pytest.raises(FileMissing, match="cannot read this mesh file"):
            load_mesh(path)


def test_a_mesh_is_kept_until_its_file_has_another_time_or_size(tmp_path):
    path = tmp_path / "mesh.obj"

    def mesh_of(face, time):
        path.write_text(f"{SQUARE}f {face}\n")
        os.utime(path, ns=(time, time))
        return Mesh(file=str(path)).mesh()

    time = 1_700_000_000_000_000_000  # ns
    first = mesh_of("1 2 3", time)
    assert mesh_of("1 2 3", time) is first
    assert np.array_equal(mesh_of("2 3 4", time + 1000).faces, [(1, 2, 3)])  # within the same second
    assert len(mesh_of("1 2 3 4", time + 1000).faces) == 2

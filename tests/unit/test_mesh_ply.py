"""PLY files: ascii and binary of both byte orders."""

import struct

import numpy as np
import pytest

from caster.description.errors import FileMissing, SceneError
from caster.geometry.mesh_files import load_mesh

VERTICES = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.5)]
TRIANGLES = [(0, 1, 2), (0, 2, 3)]
ENCODINGS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
CODES = {
    **{"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I"},
    **{"int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I"},
    **{"float": "f", "double": "d", "float32": "f", "float64": "d"},
}
XYZ = ["float x", "float y", "float z"]
CORNERS = ["list uchar int vertex_indices"]


def ply(encoding, *elements, newline="\n", extra=()):
    """A PLY file, spelt out value by value: elements are (name, properties, rows), lists are tuples."""
    lines = ["ply", f"format {encoding} 1.0", *extra]
    for name, properties, rows in elements:
        lines += [f"element {name} {len(rows)}", *(f"property {p}" for p in properties)]
    header = newline.join([*lines, "end_header", ""]).encode()
    table = [cells_of(properties, row) for _, properties, rows in elements for row in rows]
    if encoding == "ascii":
        lines = [" ".join(repr(value) for _, value in row) for row in table]
        return header + newline.join([*lines, ""]).encode()
    order = ENCODINGS[encoding]
    return header + b"".join(struct.pack(order + code, value) for row in table for code, value in row)


def cells_of(properties, row):
    return [cell for declared, value in zip(properties, row, strict=True) for cell in cells(declared, value)]


def cells(declared, value):
    """[(struct code, number)] of one property of one row."""
    words = declared.split()
    if words[0] != "list":
        return [(CODES[words[0]], value)]
    return [(CODES[words[1]], len(value)), *((CODES[words[2]], item) for item in value)]


def faces_of(polygons):
    return ("face", CORNERS, [(polygon,) for polygon in polygons])


def square(encoding="ascii", polygons=TRIANGLES, vertices=VERTICES, **options):
    return ply(encoding, ("vertex", XYZ, vertices), faces_of(polygons), **options)


@pytest.fixture
def load(tmp_path):
    def load_bytes(data):
        path = tmp_path / "mesh.ply"
        path.write_bytes(data)
        return load_mesh(path)

    return load_bytes


@pytest.fixture(params=ENCODINGS)
def encoding(request):
    return request.param


def test_triangles_come_back_as_written(load, encoding):
    mesh = load(square(encoding))
    assert np.array_equal(mesh.vertices, VERTICES) and np.array_equal(mesh.faces, TRIANGLES)
    assert mesh.normals is None and mesh.uv is None
    assert mesh.vertices.dtype == np.float64 and mesh.faces.dtype == np.int32


def test_polygons_of_mixed_sizes_become_fans(load, encoding):
    mesh = load(square(encoding, [(0, 1, 2), (0, 1, 2, 3), (3, 2, 1)]))
    assert np.array_equal(mesh.faces, [(0, 1, 2), (0, 1, 2), (0, 2, 3), (3, 2, 1)])


def test_quads_only_become_fans(load, encoding):
    mesh = load(square(encoding, [(0, 1, 2, 3), (3, 2, 1, 0)]))
    assert np.array_equal(mesh.faces, [(0, 1, 2), (0, 2, 3), (3, 2, 1), (3, 1, 0)])


@pytest.mark.parametrize("index", ["char", "uchar", "short", "ushort", "int", "uint", "int8", "uint32"])
@pytest.mark.parametrize("count", ["uchar", "int", "uint32"])
def test_any_whole_number_type_will_do_for_indices(load, encoding, index, count):
    faces = ("face", [f"list {count} {index} vertex_index"], [(t,) for t in TRIANGLES])
    mesh = load(ply(encoding, ("vertex", XYZ, VERTICES), faces))
    assert np.array_equal(mesh.faces, TRIANGLES)


def test_double_keeps_all_digits_and_float_its_own(load, encoding):
    numbers = (0.1, 1 / 3, 1e-300)
    double = ("vertex", ["double x", "float64 y", "double z"], [numbers] * 3)
    assert np.array_equal(load(ply(encoding, double, faces_of([(0, 1, 2)]))).vertices, [numbers] * 3)


def test_binary_float_is_widened_exactly(load):
    mesh = load(square("binary_big_endian", [(0, 1, 2)], [(0.1, 0.2, 0.3)] * 3))
    assert np.array_equal(mesh.vertices, np.float64(np.float32([(0.1, 0.2, 0.3)] * 3)))


@pytest.mark.parametrize("names", [("u", "v"), ("s", "t"), ("texture_u", "texture_v")])
def test_normals_and_uv_are_read_by_name_wherever_they_stand(load, encoding, names):
    u, v = names
    properties = [f"float {v}", "float nz", "float y", "uchar red", "float ny", "float z", "double nx"]
    properties += ["float x", f"float {u}"]
    rows = [(0.25, 4.0, y, 255, 3.0, z, 0.0, x, 0.75) for x, y, z in VERTICES]
    mesh = load(ply(encoding, ("vertex", properties, rows), faces_of(TRIANGLES)))
    assert np.array_equal(mesh.vertices, VERTICES)
    assert np.allclose(mesh.normals, [(0, 0.6, 0.8)] * 4, rtol=0, atol=2.0**-52)  # brought to unit length
    assert np.array_equal(mesh.uv, [(0.75, 0.25)] * 4)  # not turned over


@pytest.mark.parametrize("many", [[(1, 2), (3, 4)], [(1,), ()]], ids=["equal lists", "ragged lists"])
def test_unknown_elements_and_properties_are_passed_over(load, encoding, many):
    strange = ("strange", ["list uchar short things", "double one"], [(things, 0.5) for things in many])
    face = ["int flags", "list uchar float weights", *CORNERS, "float area"]
    rows = [(7, (0.5,) * k, polygon, 1.5) for k, polygon in enumerate(TRIANGLES)]
    vertex = ("vertex", [*XYZ, "list uint uchar beside"], [(*v, (1, 2)) for v in VERTICES])
    data = ply(encoding, strange, ("face", face, rows), ("camera", ["char c"], [(1,)]), vertex)
    mesh = load(data)
    assert np.array_equal(mesh.vertices, VERTICES) and np.array_equal(mesh.faces, TRIANGLES)


def test_an_element_without_rows_is_passed_over(load, encoding):
    none = ("edge", ["list int int ends", "int kind"], [])
    mesh = load(ply(encoding, none, ("nothing", [], []), ("vertex", XYZ, VERTICES), faces_of(TRIANGLES)))
    assert np.array_equal(mesh.faces, TRIANGLES)


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"], ids=["lf", "crlf", "cr"])
def test_any_line_ending_will_do_in_the_header(load, encoding, newline):
    """The first float's bytes are line ends themselves: they belong to the body."""
    x = struct.unpack("<f", b"\n\n\r\n")[0]
    mesh = load(square(encoding, vertices=[(x, 0.0, 0.0), *VERTICES[1:]], newline=newline))
    assert np.array_equal(mesh.faces, TRIANGLES) and mesh.vertices[0, 0] == x


def test_comments_and_blank_lines_are_passed_over(load):
    data = square(extra=["comment made by hand", "obj_info none", ""])
    assert len(load(data.replace(b"1.0 0.0", b"\n1.0 \t0.0", 1)).vertices) == 4


def test_a_missing_newline_at_the_end_of_ascii_is_fine(load):
    assert len(load(square().rstrip()).faces) == 2


def test_a_truncated_ply_is_an_error_at_every_byte(load, encoding):
    """Down to the last number of ascii, which may lose digits and stay a number."""
    whole = square(encoding)
    for length in range(1, len(whole) - (2 if encoding == "ascii" else 0)):
        with pytest.raises(SceneError, match=r"mesh\.ply:"):
            load(whole[:length])


def test_truncation_states_how_much_is_there(load):
    data = square("binary_little_endian")
    with pytest.raises(SceneError, match=r"truncated: expected 2 rows of element 'face', got 1 whole ones"):
        load(data[:-1])
    with pytest.raises(SceneError, match=r"truncated: expected 4 rows of element 'vertex', got 3 whole ones"):
        load(data[: data.index(b"end_header\n") + 11 + 47])
    with pytest.raises(SceneError, match=r"truncated: expected 2 rows of element 'face', got 1$"):
        load(square()[:-9])


def test_a_count_beyond_the_file_is_truncation_not_memory(load):
    data = square("binary_little_endian").replace(b"vertex 4", b"vertex 4000000000000")
    with pytest.raises(SceneError, match="truncated: expected 4000000000000 rows"):
        load(data)


def test_a_list_longer_than_the_file_is_truncation_not_memory(load):
    faces = ("face", ["list uint uint vertex_index"], [((0, 1, 2),)])
    data = ply("binary_little_endian", ("vertex", XYZ, VERTICES), faces)
    with pytest.raises(SceneError, match="truncated: expected 1 rows of element 'face', got 0"):
        load(data[:-16] + b"\xff\xff\xff\xff" + data[-12:])


def test_a_negative_list_length_is_an_error(load):
    faces = ("face", ["list char int vertex_index"], [((0, 1, 2),)])
    data = ply("binary_big_endian", ("vertex", XYZ, VERTICES), faces)
    with pytest.raises(SceneError, match=r"row 0 of element 'face': list 'vertex_index' .* >= 0, got -1"):
        load(data[:-13] + b"\xff" + data[-12:])


def test_trailing_bytes_are_an_error(load):
    with pytest.raises(SceneError, match="expected the end after the last element, got 1 more bytes"):
        load(square("binary_little_endian") + b"\n")


def test_trailing_rows_are_an_error_with_their_line(load):
    with pytest.raises(SceneError, match=r"mesh\.ply:16: expected the end of the file .* got '3 0 1 2'"):
        load(square() + b"3 0 1 2\n")


def test_a_nan_vertex_is_kept_for_its_faces_to_be_left_out(load, encoding):
    nan = float("nan")
    mesh = load(square(encoding, vertices=[VERTICES[0], (0.0, nan, 0.0), *VERTICES[2:]]))
    assert np.isnan(mesh.vertices).tolist() == [[False] * 3, [False, True, False], [False] * 3, [False] * 3]


@pytest.mark.parametrize("index", [4, -1, 2**31 - 1])
def test_an_index_out_of_range_is_an_error_that_names_the_polygon(load, encoding, index):
    where = ":15" if encoding == "ascii" else ""
    words = rf"mesh\.ply{where}: face 1 must join vertices 0 to 3 \(the file has 4\), got "
    with pytest.raises(SceneError, match=words):
        load(square(encoding, [(0, 1, 2, 3), (0, 1, index)]))


def test_the_largest_unsigned_index_does_not_wrap_around(load, encoding):
    faces = ("face", ["list uchar uint vertex_index"], [((0, 1, 0xFFFFFFFF),)])
    with pytest.raises(SceneError, match=r"face 0 .*got 4\.29497e\+09"):
        load(ply(encoding, ("vertex", XYZ, VERTICES), faces))


@pytest.mark.parametrize("polygon", [(0, 1), (0,), ()])
def test_a_face_with_fewer_than_three_vertices_is_an_error(load, encoding, polygon):
    where = ":15" if encoding == "ascii" else ""
    words = rf"mesh\.ply{where}: face 1 needs at least 3 vertices, got {len(polygon)}"
    with pytest.raises(SceneError, match=words):
        load(square(encoding, [(0, 1, 2), polygon]))


def test_a_mesh_without_faces_is_an_error(load, encoding):
    with pytest.raises(SceneError, match="no faces"):
        load(square(encoding, []))


def test_a_zero_normal_is_an_error(load, encoding):
    properties = [*XYZ, "float nx", "float ny", "float nz"]
    rows = [(*v, 0.0, 0.0, 0.0) for v in VERTICES]
    with pytest.raises(SceneError, match="the normal of vertex 0 must have a direction"):
        load(ply(encoding, ("vertex", properties, rows), faces_of(TRIANGLES)))


@pytest.mark.parametrize(
    ("elements", "words"),
    [
        ([("vertex", XYZ, VERTICES)], "expected elements vertex and face, got no 'face'"),
        ([faces_of([])], "expected elements vertex and face, got no 'vertex'"),
        ([("vertex", XYZ[:2], []), faces_of([])], "expected the properties x, y, z of .*'vertex', got x, y"),
        ([("vertex", [*XYZ, "float nx"], []), faces_of([])], "expected the properties nx, ny, nz"),
        ([("vertex", [*XYZ[:2], "list uchar float z"], []), faces_of([])], "expected the properties x, y, z"),
        ([("vertex", XYZ, []), ("face", ["int vertex_indices"], [])], "expected a list vertex_indices or"),
        ([("vertex", XYZ, []), ("face", ["list uchar int corners"], [])], "expected a list .*got corners"),
    ],
)
def test_what_a_mesh_needs_must_be_declared(load, encoding, elements, words):
    with pytest.raises(SceneError, match=words):
        load(ply(encoding, *elements))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b"ply\n", b"plx\n", ":1: PLY header: expected the line 'ply'"),
        (b"format ascii 1.0", b"format utf8 1.0", ":2: PLY header: expected one format, .* got 'format utf8"),
        (b"format ascii 1.0", b"format ascii 2.0", ":2: PLY header: expected one format"),
        (b"element vertex", b"format ascii 1.0\nelement vertex", ":3: PLY header: expected one format"),
        (b"format ascii 1.0\n", b"", r":\d+: PLY header: expected a format line .*, got none"),
        (b"vertex 4", b"vertex four", ":3: PLY header: expected a number of rows .*got 'four'"),
        (b"vertex 4", b"vertex -4", ":3: PLY header: expected a number of rows"),
        (b"vertex 4", b"vertex " + b"9" * 400, ":3: PLY header: expected a number of rows"),
        (b"vertex 4\n", b"vertex 4\nelement vertex 4\n", ":4: PLY header: expected each element once"),
        (b"float y", b"float x", ":5: PLY header: expected each property of 'vertex' once, got 'x' again"),
        (b"float y", b"half y", r":5: PLY header: expected a type \(char, .*got 'half'"),
        (b"list uchar int", b"list float int", ":8: PLY header: expected a whole-number type .*got 'float'"),
        (b"float y", b"y", ":5: PLY header: expected element, property, .* got 'property y'"),
        (b"property float y", b"hello", ":5: PLY header: expected element, .*got 'hello'"),
        (b"element vertex 4\n", b"", ":3: PLY header: expected an element before the property 'x'"),
        (b"element face", b"element bare 2\nelement face", ":10: PLY header: expected properties of"),
        (b"end_header", b"end", ":9: PLY header: expected element"),
        (b"1.0 1.0 0.0", b"1.0 1.0 O.0", ":12: expected numbers, got '1.0 1.0 O.0'"),
        (b"1.0 1.0 0.0", b"1.0 1_0 0.0", ":12: expected numbers, got '1.0 1_0 0.0'"),
        (b"1.0 1.0 0.0", b"1.0 1.0", ":12: expected 3 numbers for a row of element 'vertex', got 2"),
        (b"1.0 1.0 0.0", b"1.0 1.0 0.0 0.0", ":12: expected 3 numbers for a row of element 'vertex', got 4"),
        (b"3 0 2 3", b"3 0 2", ":15: expected list 'vertex_indices' to be its length and as many values"),
        (b"3 0 2 3", b"-3 0 2 3", ":15: expected list 'vertex_indices'"),
        (b"3 0 2 3", b"3.5 0 2 3", ":15: expected list 'vertex_indices'"),
        (b"3 0 2 3", b"nan 0 2 3", ":15: expected list 'vertex_indices'"),
        (b"3 0 2 3", b"3 0 2 3 1", ":15: expected 4 numbers for a row of element 'face', got 5"),
        (b"3 0 2 3", b"3 0 2 1.5", r":15: face 1 must join vertices 0 to 3 .*got 1\.5"),
        (b"3 0 2 3", b"3 0 2 nan", ":15: face 1 must join vertices .*got nan"),
    ],
)
def test_a_broken_ascii_file_is_an_error_with_its_line(load, old, new, words):
    whole = square()
    assert whole.count(old) == 1
    with pytest.raises(SceneError, match=r"mesh\.ply" + words):
        load(whole.replace(old, new))


def test_an_empty_file_is_an_error(load):
    with pytest.raises(SceneError, match=r"mesh\.ply: the file is empty \(0 bytes\)"):
        load(b"")


def test_a_missing_file_is_missing(tmp_path):
    with pytest.raises(FileMissing, match=r"no\.ply: cannot read this mesh file"):
        load_mesh(tmp_path / "no.ply")


def test_of_normals_that_are_not_finite_the_first_is_named(load):
    names = ("x", "y", "z", "nx", "ny", "nz")
    head = ["ply", "format ascii 1.0", "element vertex 4", *(f"property float {name}" for name in names)]
    head += ["element face 1", "property list uchar int vertex_indices", "end_header"]
    rows = ["0 0 0 0 0 1", "1 0 0 0 nan 2", "1 1 0 3 0 1", "0 1 0 inf 5 1", "3 0 1 2"]
    with pytest.raises(SceneError, match=r"nx, ny, nz of vertex 1 must be finite numbers, got .*nan.*2") as error:
        load("\n".join([*head, *rows]).encode())
    assert "inf" not in str(error.value)

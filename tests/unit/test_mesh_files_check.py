"""Mesh files read a second and a third time: each reader by small files, and each comparison by one wrong number."""

import base64
import json
import struct
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import caster
from caster.geometry.mesh_files import load_mesh
from caster.geometry.triangle_mesh import vertex_normals
from caster.scene.model import Scene
from mitsuba_ref.judge.checks import mesh_files
from mitsuba_ref.judge.checks.mesh_files import (
    READ_ONCE,
    check_mesh_files,
    files_of,
    for_mitsuba,
    obj_statements,
    read_plainly,
)
from mitsuba_ref.reference.messages import LoadedMesh

# A quadrilateral, a triangle and a pentagon; numbers that float32 rounds.
POINTS = [(0.1, 0, 0), (1, 0.2, 0), (1, 1, 0.3), (0, 1, 0), (2.7, 0.5, 0.5), (3.1, 2, 0), (0.5, 3.3, 1)]
POLYGONS = [(0, 1, 2, 3), (1, 4, 2), (2, 4, 5, 6, 3)]
TRIANGLES = [(0, 1, 2), (0, 2, 3), (1, 4, 2), (2, 4, 5), (2, 5, 6), (2, 6, 3)]
CORNERS = np.array(POINTS, float)[np.array(TRIANGLES)]


def obj(polygons=POLYGONS, corner="{0}", before="") -> bytes:
    lines = [f"v {x} {y} {z}" for x, y, z in POINTS]
    lines += ["f " + " ".join(corner.format(i + 1, i - len(POINTS)) for i in each) for each in polygons]
    return (before + "\n".join(lines) + "\n").encode()


HEADER = (
    "ply\nformat {0} 1.0\ncomment end of nothing\nelement edge 2\nproperty uchar kind\n"
    "element vertex 7\nproperty double x\nproperty short flag\nproperty double y\nproperty double z\n"
    "element face {1}\nproperty list uchar int {2}\nproperty uchar red\nend_header\n"
)


def ply(encoding, polygons=POLYGONS, name="vertex_indices", newline="\n") -> bytes:
    head = HEADER.format(encoding, len(polygons), name).replace("\n", newline).encode()
    if encoding == "ascii":
        rows = ["3", "4", *(f"{x} -7 {y} {z}" for x, y, z in POINTS)]
        rows += [f"{len(each)} {' '.join(map(str, each))} 9" for each in polygons]
        return head + (newline.join(rows) + newline).encode()
    order = "<" if "little" in encoding else ">"
    body = bytes([3, 4]) + b"".join(struct.pack(f"{order}dhdd", x, -7, y, z) for x, y, z in POINTS)
    return head + body + b"".join(struct.pack(f"{order}B{len(each)}iB", len(each), *each, 9) for each in polygons)


def stl_binary() -> bytes:
    facets = b"".join(struct.pack("<12fH", 7, 7, 7, *each.ravel(), 5) for each in CORNERS)
    return b"solid of this name".ljust(80, b" ") + struct.pack("<I", len(CORNERS)) + facets


def stl_text() -> bytes:
    facets = [
        "facet normal 0 0 1\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in each.tolist())
        + "endloop\nendfacet"
        for each in CORNERS
    ]
    return ("solid a\n" + "\n".join(facets) + "\nendsolid a\n").encode()


def off() -> bytes:
    lines = ["OFF # a comment", "7 3 0", *(f"{x} {y} {z}" for x, y, z in POINTS), ""]
    lines += [f"{len(each)} {' '.join(map(str, each))} 1.0 0.5 # colour" for each in POLYGONS]
    return "\n".join(lines).encode()


# file -> (name, content, whether Mitsuba's loader supports all that is in it)
FILES = {
    "obj": ("a.obj", obj(), True),
    "obj with a byte order mark": ("a.obj", b"\xef\xbb\xbf" + obj(), True),
    "obj, indices from the end": ("a.obj", obj(corner="{1}"), False),
    "obj, a line continued": ("a.obj", obj().replace(b"f 1 2 ", b"f 1\\\n 2  "), False),
    "obj, vertex continued": ("a.obj", obj().replace(b"v 1 0.2 0", b"v 1 \\\n0.2 \\\n 0"), False),
    "obj, faces as fo": ("a.obj", obj().replace(b"f 2", b"fo 2"), False),
    "obj, comments and other words": ("a.obj", obj(before="# v 1 2 3\nvp 1 2\ng f 1 2 3\n\n"), True),
    "obj, a comment behind": ("a.obj", obj().replace(b"f 2 5 3", b"f 2 5 3 # f 1"), True),
    "ply": ("a.ply", ply("ascii"), False),
    "ply of triangles": ("a.ply", ply("ascii", TRIANGLES), True),
    "ply, little": ("a.ply", ply("binary_little_endian"), False),
    "ply, big": ("a.ply", ply("binary_big_endian", TRIANGLES), True),
    "ply, vertex_index": ("a.ply", ply("binary_little_endian", TRIANGLES, "vertex_index"), True),
    "ply, carriage returns": ("a.ply", ply("binary_little_endian", TRIANGLES, newline="\r\n"), True),
    "stl": ("a.stl", stl_binary(), False),
    "stl in text": ("a.stl", stl_text(), False),
    "off": ("a.off", off(), False),
}


@pytest.fixture(params=FILES)
def file(request, tmp_path):
    name, content, _ = FILES[request.param]
    path = tmp_path / name
    path.write_bytes(content)
    return path, request.param


def test_plain_python_reads_the_faces_of_every_kind_of_file(file):
    path, name = file
    found = read_plainly(path)
    expected = CORNERS.astype(np.float32).astype(float) if name == "stl" else CORNERS
    assert np.array_equal(found.corners, expected) and found.plain is FILES[name][2]
    assert found.vertices == (3 * len(CORNERS) if path.suffix == ".stl" else len(POINTS))
    if path.suffix != ".stl":  # that is trimesh's, which need not be here
        mesh = load_mesh(path)
        assert np.array_equal(mesh.vertices[mesh.faces], found.corners)
        assert set(mesh_files._against_plain(mesh, found).values()) == {0.0}


def test_mitsuba_gets_the_file_or_the_same_faces_in_one_that_it_supports(file, tmp_path):
    path, name = file
    given = for_mitsuba(path, tmp_path, 3)
    if FILES[name][2]:
        assert given == path
        return
    assert given == tmp_path / "mesh-file-3.obj"
    mesh = load_mesh(given)
    assert np.array_equal(mesh.vertices[mesh.faces], read_plainly(path).corners)
    assert all(plain for _, plain in obj_statements(given.read_bytes())) and b"\\" not in given.read_bytes()


def test_a_large_file_and_one_of_another_kind_are_not_read_in_plain_python(tmp_path, monkeypatch):
    path = tmp_path / "a.OBJ"
    path.write_bytes(obj())
    monkeypatch.setattr(mesh_files, "MAX_PLAIN_BYTES", len(obj()))
    assert read_plainly(path) is not None
    monkeypatch.setattr(mesh_files, "MAX_PLAIN_BYTES", len(obj()) - 1)
    assert read_plainly(path) is None and for_mitsuba(path, tmp_path, 0) == path
    assert read_plainly(tmp_path / "a.glb") is None


def test_the_corners_that_have_uv_or_a_normal_are_separated():
    whole = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nvt 0 0\n"
    for faces, uv, normals in (
        (b"f 1 2 3\n", [[0, 0, 0]], [[0, 0, 0]]),
        (b"f 1//1 2// 3//1\n", [[0, 0, 0]], [[1, 0, 1]]),
        (b"f 1/1/1 2/1 3\nf -1/-1/-1 2/1/ 3//1\n", [[1, 1, 0], [1, 1, 0]], [[1, 0, 0], [1, 0, 1]]),
        (b"f 1/1 2 3//1 1/1/1\n", [[1, 0, 0], [1, 0, 1]], [[0, 0, 1], [0, 1, 1]]),
    ):
        found = mesh_files.plain_obj(whole + faces)
        assert found.has(mesh_files.UV).tolist() == uv and found.has(mesh_files.NORMAL).tolist() == normals
    assert not mesh_files.plain_ply(ply("ascii")).has(mesh_files.NORMAL).any()
    last = list(obj_statements(b"v 1 2 3\nvt 0 0\nvn 0 0 1\nf -1/-1/-1\n"))[-1]
    assert last == ([b"f", b"1/1/1"], False)


# ---- comparison

NORMALS = [(0.36, 0.48, 0.8), (0, 0, 1), (0.6, 0, 0.8), (0, 1, 0), (1, 0, 0), (0, 0.6, 0.8), (0.8, 0.6, 0)]


def scene_with(path) -> Scene:
    camera = caster.Pinhole(eye=(0, 0, 5), look_at=(0, 0, 0))
    film = caster.Film(width=2, height=2)
    return Scene(film=film, camera=camera, shapes=[{"type": "mesh", "file": str(path)}])


@pytest.fixture
def smooth(tmp_path):
    """A file with normals and uv, and what Mitsuba's loader gives of it."""
    lines = [f"v {x} {y} {z}" for x, y, z in POINTS] + [f"vn {x} {y} {z}" for x, y, z in NORMALS]
    lines += [f"vt {0.1 * i} {3.0 - 0.7 * i}" for i in range(7)]
    lines += ["f " + " ".join(f"{i + 1}/{i + 1}/{i + 1}" for i in each) for each in POLYGONS]
    path = tmp_path / "smooth.obj"
    path.write_text("\n".join(lines) + "\n")
    mesh = load_mesh(path)
    corners, normals, uv = (values[mesh.faces].astype(np.float32) for values in (mesh.vertices, mesh.normals, mesh.uv))
    return path, LoadedMesh(corners.astype(float), normals.astype(float), uv.astype(float), mesh.faces)


def verdict(path, loaded):
    found = check_mesh_files(scene_with(path), (loaded,))
    assert found.name == "mesh_files"
    return found


def test_what_mitsuba_reads_is_what_the_caster_has_read(smooth):
    path, loaded = smooth
    assert verdict(path, loaded).ratio < 1.0
    half = np.array(POINTS).astype(np.float32)[4, 0]
    moved = loaded.corners.copy()
    moved[2, 1, 0] = np.nextafter(half, np.float32(9))
    assert verdict(path, loaded._replace(corners=moved)).what == "corners of smooth.obj"
    assert verdict(path, loaded._replace(corners=moved)).ratio == np.inf
    assert not verdict(path, loaded._replace(corners=loaded.corners[:-1])).ok
    assert not verdict(path, loaded._replace(corners=loaded.corners[:, [1, 2, 0]])).ok


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_normals_and_uv_may_be_off_by_their_roundings_and_no_more(smooth, share):
    """8 roundings of float32 of a unit normal, 2 of 1 + |uv|."""
    path, loaded = smooth
    mesh = load_mesh(path)
    at = mesh.faces[3, 2]
    normals = mesh.normals[mesh.faces].copy() * 5.0
    across = np.cross(mesh.normals[at], [0.0, 0.3, 1.0])
    across /= np.abs(across).max()
    normals[3, 2] += 5.0 * share * 8 * 2.0**-24 * across
    found = verdict(path, loaded._replace(normals=normals))
    assert found.what == "normals of smooth.obj" and found.ratio == pytest.approx(share, rel=0.05)
    uv = mesh.uv[mesh.faces].copy()
    uv[3, 2, 1] += share * 2 * 2.0**-24 * (1.0 + abs(uv[3, 2, 1]))
    found = verdict(path, loaded._replace(uv=uv, normals=mesh.normals[mesh.faces]))
    assert found.what == "uv of smooth.obj" and found.ratio == pytest.approx(share, rel=0.02)
    assert found.ok is (share < 1.0)
    for part in ("normals", "uv"):
        other = getattr(loaded, part)
        assert verdict(path, loaded._replace(**{part: other[:-1]})).ratio == np.inf
        assert verdict(path, loaded._replace(**{part: np.nan * other})).ratio == np.inf


def test_where_float64_lies_between_two_float32_either_is_right(tmp_path):
    path = tmp_path / "tie.obj"
    middle = 1.0 + 2.0**-24
    path.write_text(f"v {middle!r} 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n")
    corners = np.array([[[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]])
    nothing = np.zeros((1, 3, 3)), np.zeros((1, 3, 2)), np.arange(3)[None]
    for value, right in ((1.0, True), (1.0 + 2.0**-23, True), (1.0 + 2.0**-22, False), (1.0 - 2.0**-24, False)):
        corners[0, 0, 0] = value
        assert verdict(path, LoadedMesh(corners.copy(), *nothing)).ok is right


def test_another_float64_than_plain_pythons_is_found_where_float32_is_the_same(smooth, monkeypatch):
    path, loaded = smooth
    read = mesh_files.read_plainly

    def off(file):
        found = read(file)
        found.points[2, 1] = np.nextafter(found.points[2, 1], 2.0)
        return found

    monkeypatch.setattr(mesh_files, "read_plainly", off)
    found = verdict(path, loaded)
    assert (found.what, found.ratio) == ("float64 of smooth.obj", np.inf)


def test_every_file_is_compared_once_and_has_to_be_read(smooth, tmp_path):
    path, loaded = smooth
    scene = scene_with(path)
    twice = scene.model_copy(update={"shapes": scene.shapes * 2})
    assert list(files_of(twice)) == [path] and check_mesh_files(twice, (loaded,)).ok
    for given in ((), (loaded, loaded)):
        found = check_mesh_files(scene, given)
        assert found.ratio == np.inf and f"1 files, Mitsuba has read {len(given)}" in found.what
    assert check_mesh_files(scene.model_copy(update={"shapes": ()}), ()).what == "nothing to look at"


@pytest.mark.parametrize("wrong", [0, 1])
def test_of_two_files_of_one_name_each_is_compared(smooth, tmp_path, wrong):
    path, loaded = smooth
    (tmp_path / "beside").mkdir()
    other = tmp_path / "beside" / path.name
    other.write_bytes(path.read_bytes())
    scene = scene_with(path)
    scene = scene.model_copy(update={"shapes": (*scene.shapes, *scene_with(other).shapes)})
    assert check_mesh_files(scene, (loaded, loaded)).ok
    answers = [loaded, loaded]
    answers[wrong] = loaded._replace(corners=loaded.corners + 1.0)
    found = check_mesh_files(scene, tuple(answers))
    assert found.ratio == np.inf and found.what == f"corners of {(path, other)[wrong]}"


def test_a_file_that_neither_reads_fails(smooth, monkeypatch):
    path, loaded = smooth
    refused = loaded._replace(problem="cannot", corners=loaded.corners[:0])
    found = verdict(path, refused)
    assert found.ok and "not compared: Mitsuba's loader says 'cannot'" in found.what
    monkeypatch.setattr(mesh_files, "MAX_PLAIN_BYTES", 10)
    assert verdict(path, refused).ratio == np.inf and verdict(path, loaded).ratio < 1.0
    mesh = load_mesh(path)
    for ending, ratio in ((".glb", 0.0), (".obj", np.inf), (".ply", np.inf)):
        found = mesh_files._against_mitsuba(mesh, refused, None, Path(f"a{ending}"))
        assert list(found.values()) == [ratio] and (READ_ONCE in found) is (ending == ".glb")


def merged(mesh):
    """Vertices at one place are one."""
    vertices, number = np.unique(mesh.vertices, axis=0, return_inverse=True)
    return mesh._replace(vertices=vertices, faces=number.ravel()[mesh.faces])


def split(mesh):
    """Every corner has a vertex of its own."""
    return mesh._replace(
        vertices=mesh.vertices[mesh.faces].reshape(-1, 3), faces=np.arange(mesh.faces.size).reshape(-1, 3)
    )


def one_joined(mesh):
    """The last corner names another vertex at the same place: a new one."""
    faces = mesh.faces.copy()
    faces[-1, -1] = len(mesh.vertices)
    return mesh._replace(vertices=np.concatenate([mesh.vertices, mesh.vertices[mesh.faces[-1:, -1]]]), faces=faces)


# Readers whose corners are all where they should be, as numbers in any order.
WRONG_MESHES = {
    "merged": merged,
    "split": split,
    "one vertex twice": one_joined,
    "a vertex that no face has": lambda m: m._replace(vertices=np.concatenate([m.vertices, m.vertices[:1]])),
    "normals that the file lacks": lambda m: m._replace(normals=vertex_normals(m.vertices, m.faces)),
    "uv that the file lacks": lambda m: m._replace(uv=m.vertices[:, :2]),
    "the last face first": lambda m: m._replace(faces=np.roll(m.faces, 1, axis=0)),
    "two faces exchanged": lambda m: m._replace(faces=np.concatenate([m.faces[1::-1], m.faces[2:]])),
    "faces begun elsewhere": lambda m: m._replace(faces=np.roll(m.faces, 1, axis=1)),
    "inside out": lambda m: m._replace(faces=m.faces[:, ::-1]),
    "one face inside out": lambda m: m._replace(faces=np.concatenate([m.faces[:1, ::-1], m.faces[1:]])),
}
# of these, kinds of files in which it is no other mesh
RIGHT = {("merged", ".obj"), ("merged", ".ply"), ("merged", ".off"), ("merged", ".gltf"), ("split", ".stl")}


@pytest.mark.parametrize("wrong", WRONG_MESHES)
@pytest.mark.parametrize("kind", ["obj", "ply", "stl", "stl in text", "off", "gltf"])
def test_a_reader_that_keeps_positions_and_gets_all_else_wrong_is_found(tmp_path, kind, wrong):
    """By plain Python alone: of STL, OFF and glTF Mitsuba has no reader."""
    pytest.importorskip("trimesh")
    name, content, _ = FILES.get(kind, ("a.gltf", gltf_of(NODES["turned and mirrored"]).encode(), False))
    path = tmp_path / name
    path.write_bytes(content)

    def shares(mesh):
        if kind == "gltf":
            return mesh_files._against_gltf(mesh, path)
        return mesh_files._against_plain(mesh, read_plainly(path))

    mesh = load_mesh(path)
    assert max(shares(mesh).values()) == 0.0
    other = WRONG_MESHES[wrong](mesh)
    assert (max(shares(other).values()) > 1.0) is ((wrong, path.suffix) not in RIGHT)


def test_of_a_file_too_large_for_plain_python_mitsuba_says_which_corners_share_a_vertex(smooth, monkeypatch):
    path, loaded = smooth
    monkeypatch.setattr(mesh_files, "MAX_PLAIN_BYTES", 10)
    assert verdict(path, loaded).ok
    renumbered = (loaded.vertices * 3 + 1) % 7
    assert verdict(path, loaded._replace(vertices=renumbered)).ok  # each loader counts in its own order
    apart, together = loaded.vertices.copy(), loaded.vertices.copy()
    apart[-1, -1], together[together == 6] = 7, 0
    for vertices in (apart, together, loaded.vertices[:-1]):
        found = verdict(path, loaded._replace(vertices=vertices))
        assert (found.what, found.ratio) == ("shared vertices of smooth.obj", np.inf)


@pytest.mark.parametrize("digits", ["float32", "an ulp"])
def test_normals_and_uv_of_a_file_are_those_of_plain_python_in_float64(smooth, digits):
    """Mitsuba's are float32, and of a PLY with polygons it gets the positions alone."""
    path, _ = smooth
    ply = path.with_suffix(".ply")
    rows = [
        f"{x} {y} {z} {i / 7} {0.1 * i} {' '.join(map(str, n))}"
        for i, ((x, y, z), n) in enumerate(zip(POINTS, NORMALS, strict=True))
    ]
    head = "".join(f"property double {name}\n" for name in ("x", "y", "z", "s", "t", "nx", "ny", "nz"))
    faces = [f"{len(each)} {' '.join(map(str, each))}" for each in POLYGONS]
    ply.write_text(
        f"ply\nformat ascii 1.0\nelement vertex 7\n{head}element face {len(faces)}\n"
        "property list uchar int vertex_indices\nend_header\n" + "\n".join(rows + faces) + "\n"
    )
    for file in (path, ply):
        mesh, plain = load_mesh(file), read_plainly(file)
        assert max(mesh_files._against_plain(mesh, plain).values()) < 1.0 and mesh.uv is not None
        for what in ("normals", "uv"):
            values = getattr(mesh, what)
            off = values.astype(np.float32).astype(float) if digits == "float32" else np.nextafter(values, 9.0)
            found = mesh_files._against_plain(mesh._replace(**{what: off}), plain)
            beyond = [name for name, share in found.items() if share > 1.0]
            assert beyond == ([] if (what, digits) == ("normals", "an ulp") else [f"float64 {what}"])


def test_normals_are_compared_where_the_file_itself_was_read(smooth, tmp_path):
    """The copy of a PLY has positions alone; that of an OBJ has all. Mixed corners have normals of their own rule."""
    path, loaded = smooth
    wrong = loaded._replace(normals=-loaded.normals, uv=loaded.uv + 1.0)
    mesh, plain = load_mesh(path), read_plainly(path)

    def compared(found, ending) -> set[str]:
        return set(mesh_files._against_mitsuba(mesh, wrong, found, Path(f"a{ending}"))) - {"corners", "shared vertices"}

    both = {"normals", "uv"}
    assert compared(plain, ".obj") == compared(plain._replace(plain=False), ".obj") == both
    assert compared(None, ".ply") == compared(plain, ".ply") == both
    assert compared(plain._replace(plain=False), ".ply") == set()
    bare = mesh._replace(normals=None, uv=None)
    assert set(mesh_files._against_mitsuba(bare, wrong, plain, Path("a.obj"))) == {"corners", "shared vertices"}


MIXED = """vt 0.25 0.125
vt 0.75 0.5
vn 0 1 0
vn 0.6 0 0.8
vn 0 -3 4
f 1/1/2 2//3 3/2
f 3/2/3 4 5//1
f 1 2 5
f 2/1 6/1/2 5/2/2
f 7 7 7//1
"""


@pytest.fixture
def mixed(tmp_path):
    """A file in which some corners have a normal, some uv; Mitsuba's numbers at the others are none."""
    path = tmp_path / "mixed.obj"
    path.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in POINTS) + MIXED)
    mesh, plain = load_mesh(path), read_plainly(path)
    corners, normals, uv = (values[mesh.faces].copy() for values in mesh[:1] + mesh[2:])
    normals[~plain.has(mesh_files.NORMAL)], uv[~plain.has(mesh_files.UV)] = np.nan, 7.0
    return path, LoadedMesh(corners.astype(np.float32).astype(float), normals, uv, mesh.faces)


def shares_of(path, loaded, mesh) -> dict[str, float]:
    plain = read_plainly(path)
    against = mesh_files._against_mitsuba(mesh, loaded, plain, Path("a.obj"))
    return against | mesh_files._against_plain(mesh, plain)


def test_where_some_corners_have_a_normal_each_is_compared_with_mitsubas_or_generated_again(mixed):
    """At every vertex of the mesh, one at a time, it is one of the two that finds another number."""
    path, loaded = mixed
    mesh, plain = load_mesh(path), read_plainly(path)
    assert verdict(path, loaded).ratio < 0.7
    for row in np.unique(mesh.faces):
        at = mesh.faces == row
        for what, column in (("normals", mesh_files.NORMAL), ("uv", mesh_files.UV)):
            values = getattr(mesh, what).copy()
            values[row] = np.roll(values[row], 1) + 1e-3
            found = shares_of(path, loaded, mesh._replace(**{what: values}))
            generated = {"normals": "generated normals", "uv": "uv where the file has none"}[what]
            expected = [what, f"float64 {what}"] if plain.has(column)[at].all() else [generated]
            assert [name for name, share in found.items() if share > 1.0] == expected


def test_all_normals_and_uv_of_a_file_are_there_and_no_others(mixed, smooth):
    path, loaded = mixed
    mesh = load_mesh(path)
    for what in ("normals", "uv"):
        found = shares_of(path, loaded, mesh._replace(**{what: None}))
        assert [name for name, share in found.items() if share > 1.0] == [f"{what} or none"]
    path.write_bytes(obj(TRIANGLES))
    mesh, bare = load_mesh(smooth[0]), read_plainly(path)
    found = mesh_files._against_plain(mesh, bare)
    assert found["normals or none"] == found["uv or none"] == np.inf


def test_normals_generated_where_faces_are_not_finite_or_cancel_are_no_failure(tmp_path):
    """Two faces back to back, whose normals cancel; one with a corner at infinity, which has no part in any normal."""
    path = tmp_path / "back.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv inf 0 1\nv 9e99 1 1\nvn 0 0 1\nf 1 2 3//1\nf 1 3 2\nf 1//1 2 4\n")
    mesh, plain = load_mesh(path), read_plainly(path)
    found = mesh_files._against_plain(mesh, plain)
    assert found["generated normals"] == 0.0 and np.isfinite(mesh.normals).all()


@pytest.mark.parametrize(
    ("faces", "some"),
    [
        (b"f 1 2 3\nf 10 2 3\n", (False, False)),
        (b"f 1/1 2/2 3/30\n", (False, False)),
        (b"f 1//1 20//2 3//3\r\n  fo 1//-1 2//2 3//3 # f 1 2 3\n", (False, False)),
        (b"f 1/1/1 2/2/2 3/3/3\nf 1/1 2/2 3/3\n", (False, True)),
        (b"f 1//1 2//2 3//3\nf 1/1/1 2/2/2 3/3/3\n", (True, False)),
        (b"f 1 2//2 3\n", (False, True)),
        (b"f 1/1 2 3\nf 1//1 2 3\n", (True, True)),
        (b"v 1 2 3\nvn 1//2 3 4\n# f 1//2\n", (False, False)),
    ],
)
def test_a_large_file_is_searched_for_corners_with_and_without_uv_and_normals(faces, some):
    assert mesh_files.given_at_some(b"v 0 0 0\n" + faces) == some


def test_what_only_some_corners_of_a_large_file_have_is_reported_as_not_compared(mixed, monkeypatch):
    """Mitsuba's numbers at the others are none; positions are compared as ever."""
    path, loaded = mixed
    monkeypatch.setattr(mesh_files, "MAX_PLAIN_BYTES", 10)
    assert verdict(path, loaded).ok
    found = mesh_files._against_mitsuba(load_mesh(path), loaded, None, path)
    reported = [f"{what} {mesh_files.AT_SOME}" for what in ("normals", "uv")]
    assert found == {"corners": 0.0, "shared vertices": 0.0, **dict.fromkeys(reported, 0.0)}
    assert not verdict(path, loaded._replace(corners=loaded.corners + 1.0)).ok


# ---- glTF


def gltf_of(nodes, *, stride=12, mode=None, extra=None):
    """Two triangles of POINTS, with indices, and one without; nodes: of meshes 0 and 1."""
    points = np.array(POINTS[:6], np.float32)
    rows = np.zeros((6, stride // 4), np.float32)
    rows[:, :3] = points
    indices = np.array([0, 1, 2, 2, 3, 4], np.uint16).tobytes()
    data = rows.tobytes() + indices
    accessor = {"bufferView": 0, "componentType": 5126, "type": "VEC3"}
    part = {"attributes": {"POSITION": 0}, "indices": 1}
    tree = {
        "asset": {"version": "2.0"},
        "buffers": [
            {"byteLength": len(data), "uri": "data:application/octet-stream;base64," + base64.b64encode(data).decode()}
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": len(rows.tobytes()), "byteStride": stride},
            {"buffer": 0, "byteOffset": len(rows.tobytes()), "byteLength": len(indices)},
        ],
        "accessors": [
            {**accessor, "count": 6},
            {"bufferView": 1, "componentType": 5123, "type": "SCALAR", "count": 6},
            {**accessor, "count": 3, "byteOffset": 3 * stride},
        ],
        "meshes": [
            {"primitives": [part if mode is None else {**part, "mode": mode}]},
            {"primitives": [{"attributes": {"POSITION": 2}}]},
        ],
        "nodes": nodes,
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    }
    return json.dumps(tree | (extra or {}))


NODES = {
    "one": [{"mesh": 0}],
    "moved": [{"mesh": 0, "translation": [1.5, -2.25, 0.1]}],
    "turned and mirrored": [{"mesh": 0, "rotation": [0.5, 0.1, -0.3, 0.8], "scale": [1.1, -0.7, 2.0]}],
    "instances below a matrix": [
        {"children": [1, 2, 3], "matrix": [0, 2, 0, 0, -2, 0, 0, 0, 0, 0, 2, 0, 7, 8, 9, 1]},
        {"mesh": 1, "scale": [0.3, 0.3, 0.3]},
        {"mesh": 0, "translation": [1, 1, 1]},
        {"mesh": 1, "rotation": [0, 0, 0.6, 0.8]},
    ],
}


@pytest.mark.parametrize("stride", [12, 32])
@pytest.mark.parametrize("nodes", NODES.values(), ids=NODES)
def test_the_meshes_of_a_gltf_scene_are_compared_in_any_order(tmp_path, nodes, stride):
    pytest.importorskip("trimesh")
    path = tmp_path / "a.gltf"
    path.write_text(gltf_of(nodes, stride=stride))
    nothing = np.zeros((0, 3, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3, 2)), np.zeros((0, 3), int)
    refused = LoadedMesh(*nothing, "no such file type")
    found = verdict(path, refused)
    assert found.ok and found.what == "triangles of a.gltf", found
    mesh = load_mesh(path)
    last_first = mesh._replace(faces=np.roll(mesh.faces, 1, axis=0))
    wrong = {
        "moved": mesh._replace(vertices=mesh.vertices + np.array([0.0, 0.0, 1e-9])),
        "turned": mesh._replace(faces=mesh.faces[:, [0, 2, 1]]),
        "begun elsewhere": mesh._replace(faces=mesh.faces[:, [1, 2, 0]]),
        "twice": mesh._replace(faces=np.concatenate([mesh.faces, mesh.faces[:1]])),
        "one lost": mesh._replace(faces=mesh.faces[1:]),
        "in the middle of a mesh": mesh._replace(faces=mesh.faces[::-1]),
    }
    assert (mesh_files._against_gltf(last_first, path)["triangles"] == 0.0) is (len(nodes) > 1)
    for name, other in wrong.items():
        assert mesh_files._against_gltf(other, path)["triangles"] > 1.0, name


def test_what_few_gltf_files_have_is_reported_as_not_compared(tmp_path):
    path = tmp_path / "a.gltf"
    mesh = SimpleNamespace(vertices=np.zeros((3, 3)), faces=np.zeros((1, 3), int))
    others = {"extensionsRequired": ["packed"]}, {"nodes": []}, {"buffers": [{"uri": "none.bin"}]}, {"accessors": [{}]}
    circle = [{"children": [1]}, {"children": [0], "mesh": 0}]
    texts = [
        gltf_of(NODES["one"], mode=5),
        gltf_of(circle),
        "[]",
        *(gltf_of(NODES["one"], extra=extra) for extra in others),
    ]
    for text in texts:
        path.write_text(text)
        assert mesh_files._against_gltf(mesh, path) == {READ_ONCE: 0.0}


def test_a_glb_file_and_a_buffer_beside_are_read(tmp_path):
    tree = json.loads(gltf_of(NODES["moved"]))
    data = base64.b64decode(tree["buffers"][0].pop("uri").partition(",")[2])
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = [(text, b"JSON"), (data + bytes(-len(data) % 4), b"BIN\0")]
    body = b"".join(len(chunk).to_bytes(4, "little") + kind + chunk for chunk, kind in chunks)
    head = b"glTF" + (2).to_bytes(4, "little") + (12 + len(body)).to_bytes(4, "little")
    (tmp_path / "a.glb").write_bytes(head + body)
    tree["buffers"][0]["uri"] = "a%20b.bin"
    (tmp_path / "a b.bin").write_bytes(data)
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    found = [mesh_files.plain_gltf(tmp_path / name) for name in ("a.glb", "a.gltf")]
    points = np.array(POINTS[:6], np.float32) + np.array([1.5, -2.25, 0.1])
    corners = points[[[0, 1, 2], [2, 3, 4]]]
    assert all(np.allclose(each.meshes[0].corners, corners, atol=1e-15) and len(each.meshes) == 1 for each in found)

"""The caster's mesh readers against Mitsuba's own loader: valid files, and each kind of reading error."""

import numpy as np
import places
import pytest
from ply_files import INDICES, ply

import caster
import mitsuba_ref
from caster.geometry.mesh_files import load_mesh
from caster.scene.model import Scene
from mitsuba_ref.judge.checks.mesh_files import _errors, check_mesh_files, files_of
from mitsuba_ref.reference.messages import LoadedMesh

# A quadrilateral, a triangle and a pentagon; numbers that float32 rounds.
POINTS = [(0.1, 0, 0), (1, 0.2, 0), (1, 1, 0.3), (0, 1, 0), (2.7, 0.5, 0.5), (3.1, 2, 0), (0.5, 3.3, 1)]
POLYGONS = [(0, 1, 2, 3), (1, 4, 2), (2, 4, 5, 6, 3)]
TRIANGLES = [(0, 1, 2), (0, 2, 3), (1, 4, 2), (2, 4, 5), (2, 5, 6), (2, 6, 3)]
NORMALS = [(0.36, 0.48, 0.8), (0, 0, 1), (0.6, 0, 0.8), (0, 1, 0), (1, 0, 0), (0, 0.6, 0.8), (0.8, 0.6, 0)]


def obj(corner="{0}", before="") -> bytes:
    lines = [f"v {x} {y} {z}" for x, y, z in POINTS] + [f"vn {x} {y} {z}" for x, y, z in NORMALS]
    lines += [f"vt {0.1 * i} {3.0 - 0.7 * i}" for i in range(7)]
    lines += ["f " + " ".join(corner.format(i + 1, i - len(POINTS)) for i in each) for each in POLYGONS]
    return (before + "\n".join(lines) + "\n").encode()


def polygons(encoding, faces, smooth=False) -> bytes:
    names = ["x", "y", "z", *(["nx", "ny", "nz", "u", "v"] if smooth else [])]
    rows = [(*p, *n, 0.1 * i, 0.7) if smooth else p for i, (p, n) in enumerate(zip(POINTS, NORMALS, strict=True))]
    return ply(
        encoding, ("vertex", [f"double {name}" for name in names], rows), ("face", INDICES, [(f,) for f in faces])
    )


ALL = {"corners", "shared vertices", "uv", "normals"}
BARE = {"corners", "shared vertices"}
SOME = {*BARE, "uv not compared, some corners have none: those", "normals"}
FILES = {
    "obj": ("a.obj", obj(), BARE),
    "obj, smooth": ("a.obj", obj("{0}/{0}/{0}"), ALL),
    "obj, byte order mark": ("a.obj", b"\xef\xbb\xbf" + obj("{0}//{0}"), BARE | {"normals"}),
    "obj, indices from the end": ("a.obj", obj("{1}/{1}/{1}"), ALL),
    "obj, a line continued": ("a.obj", obj().replace(b"f 1 2 ", b"f 1\\\n 2  "), BARE),
    "obj, a vertex continued": ("a.obj", obj().replace(b"v 1 0.2 0", b"v 1 \\\n0.2 \\\n 0"), BARE),
    "obj, faces as fo": ("a.obj", obj().replace(b"f 2", b"fo 2"), BARE),
    "obj, carriage returns": ("a.obj", obj().replace(b"\n", b"\r"), BARE),
    "obj, comments": ("a.obj", obj(before="# v 1 2 3 \\\nvp 1 2\ng f 1 2 3\n\n"), BARE),
    "obj, some uv": ("a.obj", obj("{0}/{0}/{0}").replace(b"f 2/2/2", b"f 2//2"), SOME),
    "ply": ("a.ply", polygons("ascii", TRIANGLES), BARE),
    "ply, little": ("a.ply", polygons("binary_little_endian", TRIANGLES, smooth=True), ALL),
    "ply, big": ("a.ply", polygons("binary_big_endian", TRIANGLES, smooth=True), ALL),
}


def scene_of(path) -> Scene:
    return places.scene_of({"type": "mesh", "file": str(path)}, film={"width": 2, "height": 2})


def loaded_by_mitsuba(brought, folder, name, data):
    path = folder / name
    path.write_bytes(data)
    (theirs,) = brought(scene_of(path)).result.answer.meshes
    return path, theirs


@pytest.mark.parametrize("kind", FILES)
def test_every_kind_of_file_is_read_alike(brought, tmp_path, kind):
    name, data, compared = FILES[kind]
    path, theirs = loaded_by_mitsuba(brought, tmp_path, name, data)
    errors = _errors(load_mesh(path), theirs, path)
    assert errors.keys() == compared and max(errors.values()) < 1.0, errors


@pytest.mark.parametrize("name", ["a.ply", "a.glb", "a.stl", "a.off"])
def test_a_file_that_mitsuba_does_not_read_is_reported_as_not_compared(brought, tmp_path, name):
    if name in ("a.glb", "a.stl"):
        trimesh = pytest.importorskip("trimesh")
        data = trimesh.Scene(trimesh.creation.box()).export(file_type=name[2:])
    else:
        triangle = b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
        data = triangle if name == "a.off" else polygons("ascii", POLYGONS)
    path, theirs = loaded_by_mitsuba(brought, tmp_path, name, data)
    found = check_mesh_files(scene_of(path), (theirs,))
    assert found.ok and found.what.startswith("not compared, Mitsuba's loader says "), found


def test_a_mesh_from_arrays_is_judged_without_a_file(tmp_path):
    (tmp_path / "m.obj").write_bytes(obj("{0}//{0}"))
    file = caster.Mesh(file=str(tmp_path / "m.obj"), name="file", to_world={"translate": (0, 0, -2)})
    mesh = file.mesh()
    scene = Scene(
        camera=caster.Pinhole(eye=(2, 1, 9), look_at=(2, 1, 0)),
        film=caster.Film(width=24, height=18),
        shapes=[caster.Mesh(mesh.vertices, mesh.faces, mesh.normals, name="arrays"), file],
    )
    assert [path.name for path in files_of(scene)] == ["m.obj"]
    verdict = mitsuba_ref.validate(scene)
    assert verdict.ok and verdict.counts["agree"] > 50, verdict


def moved(rows, step):
    """Change one number by more than float32 rounding."""
    rows = rows.copy()
    rows[2, 1] += step * max(abs(rows[2, 1]), 1.0)
    return rows


# File, the least that a reader may do wrong with a number, and where it shows; tests/faults/readers.toml has more
WRONG = {
    "a number off": ("ply, big", lambda m: m._replace(vertices=moved(m.vertices, 2.0**-22)), "corners"),
    "normals off": ("obj, smooth", lambda m: m._replace(normals=moved(m.normals, 2.0**-19)), "normals"),
    "normals made up": ("ply", lambda m: m._replace(normals=np.tile([0.0, 0.6, 0.8], (7, 1))), "presence of normals"),
    "uv off": ("obj, smooth", lambda m: m._replace(uv=moved(m.uv, 2.0**-19)), "uv"),
    "uv left out": ("obj, smooth", lambda m: m._replace(uv=None), "presence of uv"),
    "uv made up": ("obj", lambda m: m._replace(uv=np.zeros((7, 2))), "presence of uv"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_mesh_that_was_read_wrongly_is_found(brought, tmp_path, wrong):
    kind, change, where = WRONG[wrong]
    path, theirs = loaded_by_mitsuba(brought, tmp_path, *FILES[kind][:2])
    errors = _errors(change(load_mesh(path)), theirs, path)
    assert errors[where] > 1.0, errors


def test_where_float64_lies_between_two_float32_either_is_right(tmp_path):
    path = tmp_path / "tie.obj"
    path.write_text(f"v {1.0 + 2.0**-24!r} 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n")
    corners = np.array([[[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]])
    nothing = np.zeros((1, 3, 3)), np.zeros((1, 3, 2)), np.arange(3)[None]
    for value, right in ((1.0, True), (1.0 + 2.0**-23, True), (1.0 + 2.0**-22, False), (1.0 - 2.0**-24, False)):
        corners[0, 0, 0] = value
        assert check_mesh_files(scene_of(path), (LoadedMesh(corners.copy(), *nothing),)).ok is right


def test_every_file_is_compared_once_and_has_to_be_read(brought, tmp_path):
    path, theirs = loaded_by_mitsuba(brought, tmp_path, "a.obj", obj())
    scene = scene_of(path)
    twice = scene.model_copy(update={"shapes": scene.shapes * 2})
    assert list(files_of(twice)) == [path] and check_mesh_files(twice, (theirs,)).ok
    found = check_mesh_files(scene, (theirs, theirs))
    assert found.ratio == np.inf and "1 files, Mitsuba has read 2" in found.what
    assert check_mesh_files(scene.model_copy(update={"shapes": ()}), ()).what == "nothing to look at"

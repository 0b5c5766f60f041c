"""Faults of the mesh readers and of generated meshes, which both sides of a comparison get: `validate` names each.

Each is an edit of a copy of the caster. All of them by `make faults` (FAULTS=all); without it only those in QUICK.
"""

import os
import re
import struct
from typing import NamedTuple

import pytest
from edited_tree import ROOT, copy_tree, edit, run

SCENE = """[film]
width = 8
height = 6
[camera]
type = "pinhole"
eye = [0.3, -4.1, 2.2]
look_at = [0, 0, 0.5]
[[light]]
type = "ambient"
radiance = [1, 1, 1]
[[shape]]
name = "it"
"""
READERS, SHAPES = "caster/geometry/mesh_files", "caster/shapes"
OBJ, PLY, TEXT, PLAIN, LOADS = (
    f"{READERS}/{name}.py" for name in ("obj", "ply", "plain_text", "plain_text", "__init__")
)
MESH = "caster/geometry/triangle_mesh.py"

POINTS = [(-1.0, -1.0, 0.1), (1.0, -1.0, 0.2), (1.25, 1.0, 1e-3), (-1.0, 1.0, 1.0), (0.0, 0.5, 2.0)]
FACES = [(0, 1, 2, 3, 4), (0, 1, 4), (1, 2, 4)]
# One of everything: polygons, negative indices, a continued line, exponents, ends of lines of other systems.
OBJ_TEXT = "".join(f"v {x} {y} {z:e}\r\n" for x, y, z in POINTS) + (
    "vt 0.25 0.125\r\nvt 0.75 0.5\r\nvn 0 0 1\r\nvn 0.6 0 0.8\r\nvn 0 -3 4\r\n"
    "f 1/1/1 2/2/2 3/2/3 \\\r\n4/1/2 5/1/1\r\nf -5/1/1 -4/2/2 -1/1/3\r\nf 2/1/1 3/2/2 5/1/3"
)


def ply(encoding: str, number: str, kind: str) -> bytes:
    """POINTS and the triangles of FACES, and with "ascii" its polygon."""
    faces = FACES if encoding == "ascii" else FACES[1:]
    head = f"ply\nformat {encoding} 1.0\nelement vertex {len(POINTS)}\n" + "".join(
        f"property {number} {axis}\n" for axis in "xyz"
    )
    head += f"element face {len(faces)}\nproperty list {kind} int vertex_indices\nend_header\n"
    if encoding == "ascii":
        rows = [*POINTS, *((len(face), *face) for face in faces)]
        return head.encode() + "".join(" ".join(map(repr, row)) + "\n" for row in rows).encode()
    order = "<" if "little" in encoding else ">"
    numbers = {"float": "f", "double": "d", "uchar": "B", "int": "i"}
    body = b"".join(struct.pack(f"{order}3{numbers[number]}", *point) for point in POINTS)
    body += b"".join(struct.pack(f"{order}{numbers[kind]}{len(face)}i", len(face), *face) for face in faces)
    return head.encode() + body


NORMALS_TEXT = (
    b"ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\n"
    b"property double nx\nproperty double ny\nproperty double nz\nelement face 2\n"
    b"property list uchar int vertex_indices\nend_header\n"
    b"-1.0 -1.0 0.1 0 0 1\n1.0 -1.0 0.2 0.1 0 1\n0.25 1.0 0.5 0 0.3 1\n-1.0 1.0 1.0 -0.1 0.7 1\n3 0 1 3\n3 0 2 3\n"
)
FILES = {
    "mesh.obj": OBJ_TEXT.encode(),
    "mixed.obj": "".join(f"v {x} {y} {z}\n" for x, y, z in POINTS).encode()
    + b"vt 0.25 0.125\nvt 0.75 0.5\nvn 0 0 1\nvn 0.6 0 0.8\nvn 0 -3 4\n"
    + b"f 1/1/1 2//2 3/2\nf 3/2/3 4 5//1\nf 1 2 5\nf 2/1 3/1/2 5/2/2\n",
    "plain.obj": "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in POINTS).encode() + b"f 1 2 3 4 5\nf 1 2 5",
    "ascii.ply": ply("ascii", "double", "uchar"),
    "little.ply": ply("binary_little_endian", "double", "uchar"),
    "big.ply": ply("binary_big_endian", "float", "int"),
    "normals.ply": NORMALS_TEXT,
    "meet.ply": NORMALS_TEXT.replace(b"0.25 1.0 0.5", b"1.0 -1.0 0.2"),
    "unused.gltf": (ROOT / "scenes/meshes/mobile.gltf").read_bytes().replace(b'"count": 96', b'"count": 90'),
    **{name: (ROOT / "scenes/meshes" / name).read_bytes() for name in ("lantern.off", "shard.stl", "mobile.gltf")},
}


class Fault(NamedTuple):
    """Edits of a copy, the fields of the shape that shows it, and what `validate` says of it."""

    what: str
    shape: str  # a file, or fields
    says: str
    edits: tuple[tuple[str, str, str], ...]


def fault(what: str, shape: str, says: str, file: str, old: str, new: str, *more: tuple[str, str, str]) -> Fault:
    return Fault(what, shape, says, ((file, old, new), *more))


VERTICES = "number of vertices|shared vertices( by plain Python)?"
# What the readers of OFF, and of STL and glTF, end with.
OFF_MESH = "    return Mesh(np.array(points, np.float64).reshape(-1, 3), corners[fans])\n"
OFF_MESH_SPLIT = (
    "    every = np.array(points, np.float64)[corners[fans]]\n"
    "    return Mesh(every.reshape(-1, 3), np.arange(3 * len(every), dtype=np.int32).reshape(-1, 3))\n"
)
OFF_MESH_NORMALS = OFF_MESH.replace("[fans])", "[fans], np.tile([0.0, 0.6, 0.8], (len(points), 1)))")
OFF_MESH_LARGER = OFF_MESH.replace("(points,", "([*points, points[0]],")
TRIMESH_VERTICES, TRIMESH_FACES = "points = np.asarray(mesh.vertices, np.float64)", "np.asarray(mesh.faces)"
TRIMESH_MESH = "    return Mesh(np.ascontiguousarray(vertices), np.ascontiguousarray(faces.reshape(-1, 3), np.int32))\n"
TRIMESH_USED = "    vertices, faces = vertices[np.unique(faces)], np.unique(faces, return_inverse=True)[1]\n"
RUN_TEXT_KERNELS = (PLAIN, 'if not COMPILED or b"\\\\" in data', 'if b"\\\\" in data')
FAULTS = (
    fault(
        "a negative index one off",
        "mesh.obj",
        "mesh_files: corners",
        OBJ,
        "else count + index\n",
        "else max(count + index - 1, 0)\n",
    ),
    fault(
        "an exponent read an ulp too high",
        "mesh.obj",
        "mesh_files: float64",
        OBJ,
        "numbers = list(map(float, words))",
        'numbers = [float(np.nextafter(float(w), 9)) if b"e" in w else float(w) for w in words]',
    ),
    fault(
        "polygons as strips",
        "mesh.obj",
        "mesh_files: corners",
        MESH,
        "np.stack([first, first + nth + 1",
        "np.stack([first + nth, first + nth + 1",
    ),
    fault(
        "the last face dropped",
        "mesh.obj",
        "mesh_files: corners",
        OBJ,
        "row[triangle_fans(np.array(sizes, np.int64))]",
        "row[triangle_fans(np.array(sizes, np.int64))][:-1]",
    ),
    fault(
        "the normal's index for the vertex",
        "mesh.obj",
        "mesh_files: corners",
        OBJ,
        'v, vt, vn = map(_index, parts, counts, ("v", "vt", "vn"))',
        'v, vt, vn = map(_index, parts, counts, ("v", "vt", "vn"))\n    v = vn if vn >= 0 else v',
    ),
    fault(
        "another corner's normal",
        "mesh.obj",
        "mesh_files: (float64 )?normals",
        OBJ,
        "found = normals[used[:, 2]]",
        "found = normals[used[:, 2] - 1]",
    ),
    fault(
        "normals in the order of the file where some corners have none",
        "mixed.obj",
        "mesh_files: (float64 )?normals",
        OBJ,
        "    if absent.any():\n        found[absent]",
        "    if absent.any():\n        found = normals[np.arange(len(used)) % len(normals)]\n        found[absent]",
    ),
    fault(
        "generated normals in the order of the vertices",
        "mixed.obj",
        "mesh_files: generated normals",
        OBJ,
        "vertex_normals(positions, faces)[used[absent, 0]]",
        "vertex_normals(positions, faces)[np.arange(absent.sum()) % len(positions)]",
    ),
    fault(
        "uv of another corner where a corner has none",
        "mixed.obj",
        "mesh_files: uv where the file has none",
        OBJ,
        "    found[absent] = 0.0\n",
        "",
    ),
    fault("uv not turned over", "mesh.obj", "mesh_files: float64 uv", OBJ, "1.0 - uv[:, 1]", "uv[:, 1]"),
    fault(
        "a continued line lost",
        "mesh.obj",
        "mesh_files: corners",
        OBJ,
        '_without_comment(next(lines, (0, b""))[1])',
        '_without_comment(next(lines, (0, b""))[1])[:0]',
    ),
    fault(
        "vertices in float32",
        "mesh.obj",
        "mesh_files: float64",
        OBJ,
        "rows = np.array(self.rows, np.float64)",
        "rows = np.array(self.rows, np.float32).astype(np.float64)",
    ),
    fault(
        "the compiled reader an ulp too high",
        "plain.obj",
        "mesh_files: float64",
        TEXT,
        "return (-x if negative else x), at, sure",
        "return (-x if negative else x * (1 + 2**-52)), at, sure",
        RUN_TEXT_KERNELS,
    ),
    fault(
        "the compiled reader's last corner",
        "plain.obj",
        "mesh_files: corners",
        TEXT,
        "sizes[f] = n - first",
        "sizes[f] = n - first - (1 if n - first > 3 else 0)",
        RUN_TEXT_KERNELS,
    ),
    fault(
        "float32 of the other byte order",
        "big.ply",
        "mesh_files: corners",
        PLY,
        "self.types = [np.dtype(byte_order + p.type)",
        'self.types = [np.dtype(("<" if p.type == "f4" else byte_order) + p.type)',
    ),
    fault(
        "doubles cut to float32",
        "little.ply",
        "mesh_files: float64",
        PLY,
        "np.stack([np.asarray(column, np.float64)",
        "np.stack([np.asarray(column, np.float32).astype(np.float64)",
    ),
    fault(
        "axes exchanged",
        "ascii.ply",
        "mesh_files: corners",
        PLY,
        'POSITION = ("x", "y", "z")',
        'POSITION = ("x", "z", "y")',
    ),
    fault(
        "numbers of a text in float32",
        "ascii.ply",
        "mesh_files: float64",
        PLY,
        "    return float(word)\n",
        "    return float(np.float32(float(word)))\n",
    ),
    *(
        fault(what, shape, f"mesh_files: ({says})", LOADS, old, new)
        for what, shape, says, old, new in (
            ("vertices of an STL merged", "shard.stl", VERTICES, "process=False", "process=True"),
            ("vertices of an OFF at every corner", "lantern.off", VERTICES, OFF_MESH, OFF_MESH_SPLIT),
            ("a vertex of an OFF without a face", "lantern.off", VERTICES, OFF_MESH, OFF_MESH_LARGER),
            ("normals of an OFF made by its reader", "lantern.off", "normals or none", OFF_MESH, OFF_MESH_NORMALS),
            (
                "faces of an OFF sorted by their corners",
                "lantern.off",
                "corners",
                "    corners = np.array([i for polygon",
                "    polygons.sort(key=len)\n    corners = np.array([i for polygon",
            ),
            (
                "polygons of an OFF around their last corner",
                "lantern.off",
                "corners",
                "polygons.append(polygon[1:])",
                "polygons.append(polygon[-1:] + polygon[1:-1])",
            ),
            ("facets of an STL from the last", "shard.stl", "corners", TRIMESH_FACES, f"{TRIMESH_FACES}[::-1]"),
            (
                "facets of an STL begun elsewhere",
                "shard.stl",
                "corners",
                TRIMESH_FACES,
                f"np.roll({TRIMESH_FACES}, 1, axis=1)",
            ),
            (
                "normals of an STL from its facets",
                "shard.stl",
                "normals or none",
                TRIMESH_MESH,
                TRIMESH_MESH.replace("np.int32))", "np.int32), np.array(scene.to_mesh().vertex_normals))"),
            ),
            ("faces of a glTF from the last", "mobile.gltf", "triangles", TRIMESH_FACES, f"{TRIMESH_FACES}[::-1]"),
            (
                "the last mesh of a glTF inside out",
                "mobile.gltf",
                "triangles",
                TRIMESH_MESH,
                f"    faces = np.concatenate([faces[:-2], faces[-2:, ::-1]])\n{TRIMESH_MESH}",
            ),
            (
                "vertices of a glTF merged",
                "mobile.gltf",
                VERTICES,
                TRIMESH_VERTICES,
                f"mesh.merge_vertices(); {TRIMESH_VERTICES}",
            ),
            (
                "vertices of a glTF without a face dropped",
                "unused.gltf",
                VERTICES,
                TRIMESH_MESH,
                TRIMESH_USED + TRIMESH_MESH,
            ),
        )
    ),
    fault(
        "vertices of a PLY joined where they meet",
        "meet.ply",
        f"mesh_files: ({VERTICES})",
        PLY,
        '        _faces(tables["face"], len(vertices), where),\n',
        "        np.unique(vertices, axis=0, return_index=True, return_inverse=True)[1].astype(np.int32)[\n"
        "            np.unique(vertices, axis=0, return_inverse=True)[1].ravel()\n"
        '        ][_faces(tables["face"], len(vertices), where)],\n',
    ),
    fault(
        "normals of a PLY left out",
        "normals.ply",
        "mesh_files: normals or none",
        PLY,
        "if any(name in vertex.columns for name in NORMAL) else None",
        "if False else None",
    ),
    fault(
        "normals of a PLY rounded to float32",
        "normals.ply",
        "mesh_files: float64 normals",
        PLY,
        "return _floats(vertex, NORMAL, where) if",
        "return _floats(vertex, NORMAL, where).astype(np.float32).astype(np.float64) if",
    ),
    fault(
        "vertices of an OBJ without regard to uv",
        "mesh.obj",
        f"mesh_files: ({VERTICES}|float64 uv)",
        OBJ,
        '    v, vt, vn = map(_index, parts, counts, ("v", "vt", "vn"))\n',
        '    v, vt, vn = map(_index, parts, counts, ("v", "vt", "vn"))\n    vt = min(vt, 0)\n',
    ),
    fault(
        "a torus larger by 1e-7",
        'type = "torus"',
        "geometry: (points|normals) of a torus",
        f"{SHAPES}/torus.py",
        "vertices = major_radius * middle",
        "vertices = (1.0 + 1e-7) * major_radius * middle",
    ),
    fault(
        "a torus larger by 1e-12",
        'type = "torus"',
        "geometry: (points|normals) of a torus",
        f"{SHAPES}/torus.py",
        "vertices = major_radius * middle",
        "vertices = (1.0 + 1e-12) * major_radius * middle",
    ),
    fault(
        "half of a torus inside out",
        'type = "torus"',
        "geometry: (closed|volume)",
        f"{SHAPES}/torus.py",
        "[here, on, on_up, here, on_up, up]",
        "[here, on_up, on, here, on_up, up]",
    ),
    fault(
        "an icosphere not pushed out",
        'type = "icosphere"',
        "geometry: (split triangles|unit sphere)",
        f"{SHAPES}/icosphere.py",
        "normalize_rows(vertices[edges[:, 0]] + vertices[edges[:, 1]])",
        "0.5 * (vertices[edges[:, 0]] + vertices[edges[:, 1]])",
    ),
    fault(
        "a hole in an icosphere",
        'type = "icosphere"',
        "geometry: (split triangles|closed|number of faces and vertices)",
        f"{SHAPES}/icosphere.py",
        "(ca, bc, c), (ab, bc, ca)]",
        "(ca, bc, c), (ab, b, ca)]",
    ),
    fault(
        "a teapot's handle flipped",
        'type = "teapot"\nsubdivisions = 2',
        "geometry: (points|normals) of the patches",
        f"{SHAPES}/teapot.py",
        "half[:, ::-1] * (1.0, -1.0, 1.0)",
        "half * (1.0, -1.0, 1.0)",
    ),
    fault(
        "a teapot's spout off by 1e-5",
        'type = "teapot"\nsubdivisions = 2',
        "geometry: (points|normals) of the patches",
        f"{SHAPES}/teapot.py",
        "2.49375",
        "2.49376",
    ),
    fault(
        "waves lower by 1e-9",
        'type = "heightfield"\nresolution = 8',
        "geometry: (points|normals) of the waves",
        f"{SHAPES}/heightfield.py",
        "phase, scale / n)",
        "phase, (1.0 - 1e-9) * scale / n)",
    ),
    fault(
        "slopes of the other sign",
        'type = "heightfield"\nresolution = 8',
        "geometry: normals of the waves",
        f"{SHAPES}/heightfield.py",
        "np.stack([-slope_x,",
        "np.stack([slope_x,",
    ),
    fault(
        "u and v of a heightfield exchanged",
        'type = "heightfield"\nresolution = 8',
        "geometry: uv of the waves",
        f"{SHAPES}/heightfield.py",
        "normals, np.stack([u, v], axis=1)",
        "normals, np.stack([v, u], axis=1)",
    ),
    fault(
        "cells of a heightfield twice",
        'type = "heightfield"\nresolution = 8',
        "geometry: (faces of half a cell|open at the rim alone)",
        f"{SHAPES}/heightfield.py",
        "(here, right, opposite, here, opposite, above)",
        "(here, right, opposite, here, right, opposite)",
    ),
)
QUICK = (
    "a negative index one off",
    "generated normals in the order of the vertices",
    "doubles cut to float32",
    "a torus larger by 1e-7",
)
CHOSEN = [each for each in FAULTS if each.what in QUICK or os.environ.get("FAULTS") == "all"]


def judged(tree, folder, shape):
    """Exit code and text of `validate` by the copy, on a scene of one shape."""
    for name, data in FILES.items():
        (folder / name).write_bytes(data)
    fields = f'type = "mesh"\nfile = "{shape}"' if shape in FILES else shape
    (folder / "it.toml").write_text(SCENE + fields + "\n")
    ended = run(tree, "validate", str(folder / "it.toml"), "-j", "1")
    return ended.returncode, ended.stdout + ended.stderr


@pytest.mark.parametrize("planted", CHOSEN, ids=lambda fault: fault.what.replace(" ", "-"))
@pytest.mark.slow("each judges in plain Python", keep=1)
def test_a_planted_fault_is_named(planted, tmp_path):
    tree = copy_tree(tmp_path / "tree")
    for each in planted.edits:
        edit(tree, *each)
    code, said = judged(tree, tmp_path, planted.shape)
    assert code == 1, f"this passes: {planted.what}\n{said}"
    check, what = planted.says.split(": ")
    found = re.search(rf"^.*  it  {check}: \S+ its bound; ({what}) of .*", said, re.MULTILINE)
    assert found, said
    print(f"{planted.what}: {found[0]}")


@pytest.mark.parametrize("shape", sorted({each.shape for each in FAULTS}) if len(CHOSEN) > len(QUICK) else ["mesh.obj"])
def test_without_a_fault_it_passes(shape, tmp_path):
    code, said = judged(ROOT, tmp_path, shape)
    assert code == 0, said


def test_every_fault_fits_the_source_of_today():
    for each in FAULTS:
        for file, old, _ in each.edits:
            assert (ROOT / file).read_text(encoding="utf-8").count(old) == 1, (each.what, file, old)
    assert set(QUICK) <= {each.what for each in FAULTS}

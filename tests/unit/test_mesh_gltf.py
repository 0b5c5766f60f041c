"""glTF files: nodes place meshes as trimesh does, but in a stated order, and whatever is broken is left to it."""

import json

import numpy as np
import pytest

from caster.description.errors import SceneError
from caster.geometry.mesh_files import GLB_HEADER, load_mesh

trimesh = pytest.importorskip("trimesh")

TURN = [0.1, 0.3, -0.05, 0.9]  # not of length 1


def glb(path, change):
    """A box and its mirror image below two nodes, with the JSON changed."""
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box(), geom_name="box", node_name="box")
    data = scene.export(file_type="glb")
    magic, version, _, size, chunk = GLB_HEADER.unpack_from(data)
    start = GLB_HEADER.size
    content = json.loads(data[start : start + size])
    mesh = next(node["mesh"] for node in content["nodes"] if "mesh" in node)
    content["nodes"] = [
        {"children": [1, 2], "translation": [1, 2, 3], "rotation": TURN, "scale": [2, 2, 2]},
        {"mesh": mesh, "rotation": [0, 0.6, 0, 0.8], "scale": [1, 1, -1]},
        {"mesh": mesh, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1e-9, 0, 0, 1]},
    ]
    content["scenes"] = [{"nodes": [0]}]
    change(content["nodes"])
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    rest = data[start + size :]
    path.write_bytes(GLB_HEADER.pack(magic, version, start + len(text) + len(rest), len(text), chunk) + text + rest)
    return path


def test_nodes_are_placed_as_by_trimesh(tmp_path):
    path = glb(tmp_path / "two.glb", lambda nodes: None)
    mesh, found = load_mesh(path), trimesh.load_scene(str(path), process=False, maintain_order=True).to_mesh()
    assert np.array_equal(mesh.faces, found.faces) and len(mesh.vertices) == 2 * (
        24 if len(found.vertices) == 48 else 8
    )
    assert mesh.vertices == pytest.approx(np.asarray(found.vertices), abs=1e-8)  # trimesh drops shifts below that


def test_a_mirrored_mesh_is_turned_inside_out_again(tmp_path):
    mesh = load_mesh(glb(tmp_path / "two.glb", lambda nodes: None))
    half = len(mesh.faces) // 2
    for part in (mesh.faces[:half], mesh.faces[half:]):
        corners = mesh.vertices[part]
        middle = corners.mean(axis=(0, 1))
        outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert ((corners[:, 0] - middle) * outward).sum(axis=1).min() > 0.0


@pytest.mark.parametrize("rotation", [[0, 0, 0, 0], [0, 0, 1], ["x", 0, 0, 1], None, [1e999, 0, 0, 1]])
def test_a_broken_rotation_is_no_traceback(tmp_path, rotation):
    path = glb(tmp_path / "two.glb", lambda nodes: nodes[1].update(rotation=rotation))
    try:
        assert len(load_mesh(path).faces) == 24
    except SceneError as error:
        assert str(path) in str(error)

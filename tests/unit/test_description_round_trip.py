"""Packed primitives come back as descriptions that pack to the same float32 numbers, for every kind there is."""

from collections.abc import Iterator

import numpy as np
import pytest
from places import scene_of
from ply_files import ply_mesh

import caster
import mitsuba_ref
from caster.geometry.mesh_files import load_mesh
from caster.geometry.packing import pack, primitive_count
from caster.geometry.world_space import as_float32
from caster.scene.files import scene_from_text
from caster.shapes import SHAPES
from mitsuba_ref.report.reproducers import pack_one
from mitsuba_ref.shapes import kind_of
from mitsuba_ref.shapes.shape_reference import unit_vector_rounding_to
from mitsuba_ref.subjects.subject import packs_identically

STRETCH = [{"scale": [0.913, -1.7, 0.4]}, {"rotate": {"axis": [1, 2, 3], "degrees": 37}}, {"translate": [0.3, 9, -4]}]
TURN = STRETCH[1:]
PRIMS = 25  # of each shape


def shapes_of(cls: type, folder) -> Iterator[caster.Sphere]:
    """Some of the kind: turned and moved, and stretched and mirrored too."""
    own = {
        "plane": {"normal": [0.3, 0.2, 0.9], "offset": 1.7},
        "triangle": {"vertices": [[0.1, 0, 0], [1, 0.3, 0], [0, 1, 0.7]], "normals": [[1, 2, 9], [3, 1, 8], [0, 1, 5]]},
        "mesh": {"file": str(folder / "mesh.ply")},
        "spheres": {"centers": [[0.1, 2, 3], [-1, 0.7, 0]], "radii": [0.3, 1.7]},
        "heightfield": {},
        "ellipsoids": {
            "centers": [[0.1, 2, 3], [-1, 0.7, 0]],
            "scales": [[0.3, 1.7, 0.1], [1, 2, 3]],
            "quaternions": [[0.1, 0.2, 0.3, 0.4], [-2, 0, 0, 1]],
        },
        "linear_curve": {"points": [[0.1, 2, 3], [-1, 0.7, 0], [0, 0, 1], [2, 1, 1]], "radii": [0.3, 1.7, 0.2, 0.2]},
    }.get(cls.model_fields["type"].default, {})
    yield from (cls(**own, to_world=place) for place in (TURN, STRETCH))
    if "normals" in own:
        yield cls(vertices=own["vertices"], uv=[[0.1, 0.2], [0.3, 0.9], [0.7, 0.1]], to_world=TURN)


@pytest.fixture
def folder(tmp_path):
    rng = np.random.default_rng(5)
    faces = [(i, i + 1, i + 2) for i in (0, 3, 6, 9)]
    (tmp_path / "mesh.ply").write_bytes(ply_mesh("ascii", rng.normal(size=(12, 3)).tolist(), faces))
    assert len(load_mesh(str(tmp_path / "mesh.ply")).faces) == 4
    return tmp_path


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.__name__)
def test_every_shape_packs_to_the_same_bits_again(shape, folder):
    checked = 0
    for one in shapes_of(shape, folder):
        (part,) = pack(scene_of(one), as_float32).parts
        for k in np.random.default_rng(1).permutation(primitive_count(part))[:PRIMS]:
            again = pack_one(read_back(kind_of(part).describe(part, k)))
            assert packs_identically(part, k, again), (one, k)
            for a, b in zip(numbers_of(again.parts[0], 0), numbers_of(part, k), strict=True):
                assert (np.asarray(a) + 0.0).tobytes() == (np.asarray(b) + 0.0).tobytes()  # zeros lose their signs
            checked += 1
    assert checked >= 2


def numbers_of(part, k):
    """All packed numbers of a primitive, apart from a sphere's rotation."""
    if hasattr(part, "faces"):
        corners, used = part.faces[k], (part.smooth[k], part.textured[k])
        return [
            part.vertices[corners],
            used,
            *(a[corners] for a, on in zip((part.normals, part.uv), used, strict=True) if on),
        ]
    return [a[k] for name, a in part._asdict().items() if name != "turn"]


def read_back(shape):
    """Through the text of a scene file, as reproducers write it."""
    scene = scene_from_text(scene_of(shape).to_toml(), "toml")
    return scene.shapes[0].model_dump(by_alias=True, exclude_none=True)


def test_other_numbers_are_noticed():
    (part,) = pack(scene_of(caster.Sphere(center=(0.1, 0.2, 0.3))), as_float32).parts
    shape = kind_of(part).describe(part, 0)
    assert packs_identically(part, 0, pack_one(shape))
    assert not packs_identically(
        part, 0, pack_one(shape | {"radius": float(np.nextafter(np.float32(1), np.float32(2)))})
    )
    assert not packs_identically(part, 0, pack_one({"type": "disk"}))


def test_vectors_of_unit_length_round_back():
    rng = np.random.default_rng(2)
    n = rng.normal(size=(3000, 3)) * 10.0 ** rng.uniform(-9.0, 0.0, (3000, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    single = as_float32(n)
    assert (np.linalg.norm(single, axis=1) != 1.0).sum() > 2000  # else there would be nothing to do
    found = np.array([unit_vector_rounding_to(each) for each in single])
    assert np.array_equal(as_float32(found), single)
    assert np.abs(np.linalg.norm(found, axis=1) - 1.0).max() <= 4 * 2.0**-53
    for exact in ([0.0, -1.0, 0.0], [0.6, 0.0, 0.8]):
        single = as_float32(np.array(exact))
        assert np.array_equal(as_float32(unit_vector_rounding_to(single)), single)
    assert unit_vector_rounding_to(np.array([0.0, -1.0, 0.0])).tolist() == [0.0, -1.0, 0.0]


def test_a_closed_curve_is_one_curve_of_all_its_points(tmp_path):
    """In Mitsuba's file each curve follows an empty line; this one begins where its last segment ends."""
    points = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 0))
    mitsuba_ref.export_xml(scene_of(caster.LinearCurve(points=points, radius=0.25)), tmp_path)
    (file,) = tmp_path.rglob("*.txt")
    assert [tuple(map(float, line.split())) for line in file.read_text().splitlines()] == [(*p, 0.25) for p in points]

"""Saved scenes load again as the same scene, to the bit."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from places import read_back

from caster.cameras import CAMERAS, Fisheye, Pinhole
from caster.description.errors import FileMissing
from caster.scene.files import load_scene, scene_from_text
from caster.scene.model import Ambient, Check, Diffuse, Directional, Film, Point, Scene, Shading
from caster.shapes import SHAPES, Sphere

NEEDS = {  # what a shape cannot do without
    "spheres": {"centers": [[0.1, 1 / 3, 5], [2, 3, 4]], "radii": [1e-300, 1 / 7]},
    "triangle": {"vertices": [[0, 0, 0], [1, 0, 0.1], [0, 1, 1e-30]], "uv": [[0, 0], [1, 0], [0, 1]]},
    "plane": {"normal": [1, 2, 3], "offset": "0x1.999999999999ap-4"},
    "mesh": {"file": "triangle.obj"},
}
STEPS = [
    {"translate": [0.1, 0.2, 0.3]},
    {"rotate": {"axis": [1, 2, 3], "degrees": 33.3}},
    {"scale": [1, -2, 1e-5]},
    {"look_at": {"origin": [1, 2, 3], "target": [3, 2, 0.7]}},
    {"matrix": [[1, 0.1, 0, 0], [0, 1, 0, 7], [0, 0, 1, 0], [0, 0, 0, 1]]},
]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "triangle.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    return tmp_path


def everything(folder):
    shapes = []
    for shape in SHAPES:
        kind = shape.model_fields["type"].default
        needs = dict(NEEDS.get(kind, shape.MINIMAL))
        if kind == "mesh":
            needs["file"] = str(folder / needs["file"])
        shapes += [shape(**needs), shape(**needs, name=f'a "{kind}"\\', material="the red", to_world=STEPS)]
    return Scene(
        film=Film(width=7, height=9, crop=(1, 1, 5, 5)),
        camera=Pinhole(eye=[0, 0, 1 / 3], direction=[1, 1, 1], fov=33.3, fov_axis="diagonal"),
        lights=[
            Point(position=[0.1, 2, 3], intensity=[1e-300, 1e300, 5]),
            Directional(direction=[1, 1, 0], irradiance=[1, 1, 1]),
            Ambient(radiance=[0, 0, 0.1]),
        ],
        materials={"the red": Diffuse(reflectance=[0.7, 0, 0], two_sided=True), "plain": Diffuse()},
        shapes=shapes,
        shading=Shading(shadows=False),
        checks={"depth": Check(ratio=1.5)},
    )


def test_every_element_survives_both(folder):
    scene = everything(folder)
    assert all(again == scene for again in read_back(scene, folder))
    again, *_ = read_back(scene, folder)
    assert again.canonical_json() == again.model_copy().canonical_json()
    assert again.to_toml() == scene_from_text(again.to_toml(), folder=folder).to_toml()


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.__name__)
def test_every_camera_survives_both(camera):
    ray = {"origin": [0.1, -0.0, 0.3], "direction": [-1 / 3, 1 / 7, -0.0], "t_max": 1e9}
    pose = {"eye": [0.1, 0.2, 0.3], "look_at": [1 / 3, 1 / 7, 0]}
    scene = Scene(camera=camera(**(pose if "eye" in camera.model_fields else ray)))
    assert all(again == scene for again in read_back(scene))


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=3, max_size=3))
def test_every_number_survives_both(center):
    scene = Scene(camera=Fisheye(eye=center, direction=[0, 0, 1]), shapes=[Sphere(center=center)])
    for again in read_back(scene):
        assert again.shapes[0].center == scene.shapes[0].center and again == scene


def test_defaults_are_left_out_of_toml():
    scene = Scene(camera=Pinhole(eye=[0, 0, 5], look_at=[0, 0, 0]), shapes=[Sphere(radius=2)])
    assert scene.to_toml() == (
        '[camera]\ntype = "pinhole"\neye = [0.0, 0.0, 5.0]\nlook_at = [0.0, 0.0, 0.0]\n\n'
        '[[shape]]\ntype = "sphere"\nradius = 2.0\n'
    )


def test_canonical_json_is_the_same_for_equal_scenes():
    a = Scene(camera=Pinhole(eye=[0, -0.0, 5], look_at=[0, 0, 0]), film=Film(width=256))
    b = Scene(film={}, camera={"look_at": (0, 0, 0), "type": "pinhole", "eye": ["0x0p0", 0, 5.0], "fov": 45})
    assert a == b and a.canonical_json() == b.canonical_json() and a.sha256() == b.sha256()
    assert json.loads(a.canonical_json())["film"] == {"height": 256, "width": 256}


def mesh_scene(folder):
    (folder / "x.toml").write_text(
        '[camera]\ntype = "panorama"\neye = [0, 0, 0]\ndirection = [0, 0, 1]\n'
        '[[shape]]\ntype = "mesh"\nfile = "triangle.obj"\n'
    )
    return load_scene(folder / "x.toml")


def test_files_in_the_scenes_folder_are_named_from_it(folder):
    scene = mesh_scene(folder)
    assert json.loads(scene.canonical_json())["shape"][0]["file"] == "triangle.obj"
    assert 'file = "triangle.obj"' in scene.with_film(width=3).to_toml()


def test_the_fingerprint_is_that_of_the_meshes_too_and_not_of_their_place(folder, tmp_path_factory):
    before, elsewhere = mesh_scene(folder).sha256(), tmp_path_factory.mktemp("elsewhere")
    (elsewhere / "triangle.obj").write_bytes((folder / "triangle.obj").read_bytes())
    assert mesh_scene(elsewhere).sha256() == before
    (elsewhere / "triangle.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 1\nf 1 2 3\n")
    assert mesh_scene(elsewhere).sha256() != before
    scene = mesh_scene(folder)
    (folder / "triangle.obj").unlink()
    with pytest.raises(FileMissing, match=r"triangle\.obj: cannot read this mesh file"):
        scene.sha256()

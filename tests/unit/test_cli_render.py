"""`caster render` writes the same bytes every time, with their provenance."""

import numpy as np
import pytest

import caster
import caster.rendering.threads
from caster.__main__ import main
from caster.aovs import AOVS
from caster.rendering.bvh_construction import bvh_of
from caster.rendering.hits import packed

pytestmark = pytest.mark.usefixtures("warm")

SCENE = """
[film]
width = 24
height = 16
[camera]
type = "pinhole"
eye = [0.3, 0.4, 5]
look_at = [0, 0, 0]
[[light]]
type = "point"
position = [2, 3, 4]
intensity = [9, 8, 7]
[[shape]]
type = "sphere"
name = "ball"
[[shape]]
type = "cube"
to_world = [{ scale = 0.4 }, { rotate = { axis = [1, 2, 3], degrees = 33 } }, { translate = [1.2, 0.5, 1] }]
"""
ALL = ",".join(aov.NAME for aov in AOVS)


@pytest.fixture
def folder(here):
    (here / "s.toml").write_text(SCENE)
    return here


def render(*options):
    assert main(["render", "s.toml", *options]) == 0


def test_the_default_is_the_scenes_name_in_this_folder_and_five_aovs(folder, capsys):
    (folder / "deep").mkdir()
    (folder / "deep" / "t.toml").write_text(SCENE)
    assert main(["render", "deep/t.toml"]) == 0
    said = capsys.readouterr()
    assert said.out.startswith("t.exr: 24 x 16 pixels, ") and said.out.endswith(
        "; hit, depth, normal, position, diffuse\n"
    )
    assert said.err == ""
    assert set(caster.read_exr("t.exr").channels) == {
        "A",
        "depth.Z",
        "normal.X",
        "normal.Y",
        "normal.Z",
        "position.X",
        "position.Y",
        "position.Z",
        *"RGB",
    }


def test_two_renders_have_the_same_bytes_on_any_number_of_threads(folder):
    for threads in ("1", "2", "5"):
        render("--aov", ALL, "--threads", threads, "-o", f"{threads}.exr")
    render("--aov", ALL, "-o", "again.exr")
    images = {path.read_bytes() for path in folder.glob("*.exr")}
    assert len(list(folder.glob("*.exr"))) == 4 and len(images) == 1


def test_the_file_states_where_it_comes_from(folder):
    render("--size", "6", "4")
    scene = caster.load_scene("s.toml").with_film(width=6, height=4)
    assert caster.read_exr("s.exr").provenance == {
        "caster/version": caster.__version__,
        "caster/scene": "s.toml",
        "caster/scene_json": scene.canonical_json(),
        "caster/scene_sha256": scene.sha256(),
        "caster/depth": "distance from the eye along the ray, scene units; inf on a miss",
    }


def test_explain_reports_what_was_done_and_what_was_left_out(folder, capsys):
    looking = 'type = "pinhole"\neye = [0.3, 0.4, 5]\nlook_at = [0, 0, 0]'
    one_ray = SCENE.replace(looking, 'type = "ray"\norigin = [1.2, 0.5, 5]\ndirection = [0, 0, -1]')
    (folder / "s.toml").write_text(one_ray + "[shading]\nshadows = false\n")
    render("--explain")
    said = capsys.readouterr().out
    cube = next(kind for kind in packed(caster.load_scene("s.toml")).kinds if len(kind.ids) == 12)
    nodes = len(bvh_of(cube).links)
    assert nodes >= 1 and f"\nBVH of triangles     {nodes} nodes\n" in said
    assert "\nculling              bvh\n" in said and "\nsurfaces             position normals of 384 hits\n" in said
    assert "\nshadow rays          0\n" in said and "\nskipped              uv, shadow rays" in said


def test_an_empty_scene_is_a_image_of_misses(folder, capsys):
    (folder / "s.toml").write_text(SCENE.partition("[[shape]]")[0])
    render("--aov", ALL, "--explain")
    assert "\nsurfaces             position normals uv of 0 hits\n" in capsys.readouterr().out
    exr = caster.read_exr("s.exr")
    assert not exr.channels["A"].any() and (exr.channels["depth.Z"] == np.inf).all()

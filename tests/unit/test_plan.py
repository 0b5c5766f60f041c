"""Steps that a scene does not need are skipped, as the account of its work shows."""

import json

import numpy as np
import pytest
from marks import compiled_only
from programs import printed_by

from caster import Cube, Fisheye, Icosphere, Orthographic, Panorama, Pinhole, Plane, Scene, Sphere
from caster.__main__ import main
from caster.cameras import Ray
from caster.cli.inspection import account
from caster.rendering.images import render_film, trace_film
from caster.scene.model import Ambient, Directional, Point

EYE = {"eye": (0.3, 0.4, 6.0), "look_at": (0.0, 0.0, 0.0)}
LAMP = Point(position=(3, 4, 5), intensity=(9, 9, 9))


def scene(camera=Pinhole, **more):
    parts = {"shapes": [Sphere(), Icosphere(subdivisions=2, to_world=[{"translate": (2, 0, 0)}])]} | more
    return Scene(film={"width": 40, "height": 30}, camera=camera(**EYE), **parts)


ALONG_A_RAY = scene().model_copy(update={"camera": Ray(origin=(2.0, 0.1, 6.0), direction=(0.0, 0.0, -1.0))})


def told(a_scene, *aovs, **how):
    return account(render_film(a_scene, aovs, **how), aovs)


@pytest.mark.parametrize("camera", [Fisheye, Panorama])
def test_cameras_that_bend_lines_grow_no_tree_either(camera):
    what = told(scene(camera), "depth", "normal")
    assert what["culling"] == "raster" and not any(kind["nodes"] for kind in what["primitives"])


def test_a_pinhole_without_shadows_grows_no_tree():
    lit = scene(lights=[LAMP], shading={"shadows": False})
    for what in (told(lit, "depth", "normal"), told(lit, "diffuse")):
        assert all(kind["nodes"] == 0 for kind in what["primitives"])


@pytest.mark.parametrize(
    ("a_scene", "aov"), [(ALONG_A_RAY, "depth"), (scene(lights=[LAMP]), "diffuse")], ids=["one ray", "shadows"]
)
def test_a_tree_is_grown_where_rays_go_through_it(a_scene, aov):
    what = told(a_scene, aov)
    assert [kind["nodes"] > 10 for kind in what["primitives"]] == [False, True]  # one sphere is too few for a tree


def test_shadow_rays_are_those_of_hits_that_face_the_light():
    lamps = [LAMP, Directional(direction=(0, -1, 0), irradiance=(1, 1, 1))]
    a_scene = scene(lights=[*lamps, Ambient(radiance=(1, 1, 1))])
    view = trace_film(a_scene)
    facing = 0
    for lamp in lamps:
        p, n = view.position[view.hit], view.shading_normal[view.hit]
        to_light = np.array(lamp.position) - p if lamp.type == "point" else -np.array([lamp.direction])
        facing += int(((n * to_light).sum(axis=1) > 0.0).sum())
    assert told(a_scene, "diffuse")["shadow_rays"] == facing > 200


@pytest.mark.parametrize(
    ("a_scene", "aov"),
    [
        (scene(lights=[LAMP]), "depth"),
        (scene(lights=[Ambient(radiance=(1, 1, 1))]), "diffuse"),
        (scene(lights=[LAMP], shading={"shadows": False}), "diffuse"),
    ],
    ids=["not asked for", "ambient", "switched off"],
)
def test_no_shadow_ray_is_cast_without_need(a_scene, aov):
    assert told(a_scene, aov)["shadow_rays"] == 0


@pytest.mark.parametrize(
    ("aovs", "parts"),
    [
        (("hit", "depth", "shape_id", "prim_id", "albedo"), []),
        (("normal", "depth"), ["normals"]),
        (("normal", "position"), ["position", "normals"]),
        (("shading_normal",), ["position", "normals"]),
        (("uv",), ["position", "normals", "uv"]),
        (("diffuse",), ["position", "normals"]),
    ],
)
def test_of_a_surface_only_what_is_requested_is_worked_out(aovs, parts):
    what = told(scene(lights=[LAMP]), *aovs)
    assert what["surfaces"]["worked_out"] == parts
    assert (what["surfaces"]["hits"] > 0) == bool(parts)


@pytest.mark.parametrize("camera", [Pinhole, Orthographic])
def test_what_lies_behind_or_beside_is_not_looked_for(camera):
    places = [(0, 0, 0), (0, 0, 9), (99, 0, 0)]  # in view, behind the eye, far off the film
    cubes = [Cube(to_world=[{"scale": 0.5}, {"translate": place}]) for place in places]
    (kind,) = told(scene(camera, shapes=cubes), "depth")["primitives"]
    assert kind["count"] == 36 and 4 <= kind["looked_for"] <= 12  # faces of the first cube; some show no pixel centre


def test_the_account_is_the_same_in_words_and_as_json(here, capsys):
    (here / "s.toml").write_text(LONELY)
    assert main(["render", "s.toml", "--aov", "depth,normal", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert (here / data["output"]).exists() and data["camera_rays"]["cast"] == 48
    assert main(["render", "s.toml", "--aov", "depth,normal", "--explain"]) == 0
    words = capsys.readouterr().out
    assert f"\nculling              {data['culling']}\n" in words
    assert f"\nsurfaces             normals of {data['surfaces']['hits']} hits\n" in words


LONELY = """[film]
width = 8
height = 6
[camera]
type = "pinhole"
eye = [0, 0, 5]
look_at = [0, 0, 0]
[[shape]]
type = "sphere"
"""


@compiled_only
def test_kernels_of_absent_shapes_and_of_what_is_not_requested_are_not_loaded(tmp_path):
    (tmp_path / "s.toml").write_text(LONELY)
    command = ["-m", "caster", "render", "s.toml", "--aov", "depth,normal", "--json"]
    kernels = json.loads(printed_by(*command, cwd=tmp_path))["kernels"]
    used = [*kernels["compiled"], *kernels["loaded"]]
    assert any("Spheres" in name for name in used)
    others = ["Triangles", "Ellipsoids", "Cylinders", "Disks", "Planes", "Tree", "Light", "Orthographic", "Fisheye"]
    assert not [name for name in used for other in others if other in name]
    asked_of = {name.partition("(")[0] for name in used}
    assert not asked_of & {"shadow_rays_in_tile", "materials_in_tile"}
    assert len(used) <= 12, used


def test_without_culling_no_tree_is_grown():
    what = told(scene(shapes=[Plane(offset=-2), Sphere()]), "depth", culling="brute-force")
    assert what["culling"] == "brute-force"
    assert [kind["nodes"] for kind in what["primitives"]] == [0, 0]


EVERYTHING_ASKED = """
import gc
import numpy as np, caster
from caster.aovs import BY_NAME
from caster.jit import machine_code
from caster.jit.decorators import Kernel
scene = caster.load_scene("scenes/every-shape.toml").with_film(width=48, height=32)
bent = scene.model_copy(update={"camera": caster.Fisheye(eye=(0.0, 1.0, 6.0), look_at=(0.0, 0.0, 0.0))})
for each in (scene, bent):
    caster.render(each, tuple(BY_NAME))
rays = np.random.default_rng(5).normal(size=(2, 500, 3))
caster.cast(scene, *rays).uv, caster.cast(scene, *rays).normal, caster.occluded(scene, *rays)
kernels = [each for each in gc.get_objects() if isinstance(each, Kernel)]
slowly = [kernel.__name__ for kernel in kernels if None in kernel._codes.values()]
print(machine_code.is_supported(), len(kernels) > 100 and slowly)
"""


@compiled_only
def test_no_kernel_of_a_render_or_a_cast_needs_numba_to_be_called():
    """Regression: for a flag among the arguments Numba was loaded, and each call took 0.13 ms."""
    usable, _, slowly = printed_by("-c", EVERYTHING_ASKED).strip().partition(" ")
    assert slowly == "[]" or usable == "False"

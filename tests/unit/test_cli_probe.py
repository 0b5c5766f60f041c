"""`caster probe`: the pixel it shows is the pixel that render computes."""

import json

import numpy as np
import pytest
from places import SCENES

import caster
from caster.__main__ import main
from caster.cli.inspection import probe
from caster.geometry.packing import pack
from caster.kernels.triangles import Triangles
from caster.rendering.images import trace_film

SCENE = """
[film]
width = 12
height = 9
[camera]
type = "{camera}"
eye = [0.3, 0.4, 5]
look_at = [0, 0, 0]
[[shape]]
type = "sphere"
name = "ball"
[[shape]]
type = "plane"
normal = [0, 1, 0.1]
offset = -1
[[shape]]
type = "cube"
name = "box"
to_world = [{{ scale = 0.4 }}, {{ rotate = {{ axis = [1, 2, 3], degrees = 9 }} }},
    {{ translate = [0.7, 0.3, 1] }}]
"""
FIELDS = {
    "n": "normal",
    "sh_n": "shading_normal",
    "p": "position",
    "uv": "uv",
    "shape_id": "shape_id",
    "prim_id": "prim_id",
}


def write(here, camera="pinhole"):
    (here / "s.toml").write_text(SCENE.format(camera=camera))
    return caster.load_scene("s.toml")


def probed(capsys, x, y, *options):
    assert main(["probe", "s.toml", str(x), str(y), "--json", *options]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("camera", ["pinhole", "orthographic", "fisheye", "panorama"])
def test_every_pixel_has_the_bits_of_render(here, camera):
    scene = write(here, camera)
    images = caster.render(scene, ("depth", *FIELDS.values()))
    assert images.hit.any() and images.hit.all() == (camera == "orthographic")  # which looks at the plane
    for y, x in [*np.ndindex(images.hit.shape)][::5]:
        hit = probe(scene, x, y)["hit"]
        assert (hit is not None) == images.hit[y, x]
        if hit:
            assert all(np.array_equal(hit[field], images[aov][y, x]) for field, aov in FIELDS.items())
            assert np.float32(hit["t"]) == np.float32(images["depth"][y, x])  # d is of length 1 to an ulp


def test_the_numbers_of_json_are_exact(here, capsys):
    scene = write(here)
    found, expected = probed(capsys, 7, 3), trace_film(scene.with_pixel(7, 3))
    o, d = (vectors[0].tolist() for vectors in expected.rays[:2])
    assert found["ray"] == {"o": o, "d": d, "t_min": 0.0, "t_max": None}
    assert found["hit"]["t"] == expected.nearest.t[0] and [found["hit"]["n"]] == expected.normal.tolist()
    assert found.items() >= probe(scene, 7, 3).items()
    assert (found["scene"], found["pixel"], found["film"]) == ("s.toml", [7, 3], [12, 9])
    assert [(hit["shape"], hit["type"]) for hit in found["alone"]][:2] == [("box", "cube"), ("ball", "sphere")]
    assert found["hit"].items() >= {name: found["alone"][0][name] for name in ("shape", "t", "prim_id")}.items()
    assert found["tried"] == {"prims": 14, "shapes": 3}


def test_the_text_shows_ray_hit_and_near_primitives(here, capsys):
    scene = write(here)
    t, prim = (each[0] for each in trace_film(scene.with_pixel(7, 3)).nearest[:2])
    assert main(["probe", "s.toml", "7", "3"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("pixel (7, 3) of s.toml, film 12 x 9\nray    o      0.3  0.4  5.0\n")
    assert f'hit    shapes[2] (cube "box"), prim {prim - 2}\n' in said
    assert repr(float(t)) in said and float(t).hex() in said
    assert "alone  4 of 14 primitives are hit, or not decided by float64\n" in said
    assert said.index('shapes[2] (cube "box"), prim') < said.index('shapes[0] (sphere "ball"), prim 0')


def test_a_miss_is_stated_and_no_failure(here, capsys):
    write(here)
    assert main(["probe", "s.toml", "0", "0"]) == 0
    assert "miss   nothing lies on this ray\n" in capsys.readouterr().out
    assert probed(capsys, 0, 0)["hit"] is None


def test_a_pixel_without_a_ray_is_stated_to_have_none(here, capsys):
    write(here, "fisheye")
    assert main(["probe", "s.toml", "0", "0"]) == 0
    assert "no ray: the pixel lies outside the image circle of the fisheye camera" in capsys.readouterr().out
    found = probed(capsys, 0, 0)
    assert found["ray"] is None and found["hit"] is None and found["alone"] == []


# ---- every primitive by itself ----

MESH = """
[film]
width = 12
height = 9
[camera]
type = "pinhole"
eye = [0.3, 0.4, 5]
look_at = [0, 0, 0]
[[shape]]
type = "icosphere"
name = "mesh"
subdivisions = 1
[[shape]]
type = "disk"
to_world = [{ translate = [0.5, 0, 1.5] }]
[[shape]]
type = "cylinder"
p1 = [0.3, 2, 0]
radius = 0.4
[[shape]]
type = "sphere"
center = [-0.2, 0, -3]
to_world = [{ scale = [1, 2, 1] }]
"""


def single(scene, shape_id, prim_id):
    """The scene of one primitive, as the same numbers."""
    shape = scene.shapes[shape_id]
    part = pack(scene).parts[shape_id]
    if not isinstance(part, Triangles):
        return scene.model_copy(update={"shapes": [shape]})
    corners = part.vertices[part.faces[prim_id]].tolist()
    return scene.model_copy(update={"shapes": [caster.Triangle(vertices=corners)]})


def test_each_primitive_answers_as_if_it_stood_alone(here):
    (here / "s.toml").write_text(MESH)
    scene = caster.load_scene("s.toml")
    kinds = set()
    for x, y in ((5, 4), (7, 3), (0, 0)):
        found = probe(scene, x, y)
        hits = [each for each in found["alone"] if each["t"] is not None]
        t_of = {(each["shape_id"], each["prim_id"]): each["t"] for each in hits}
        ray = ([found["ray"]["o"]], [found["ray"]["d"]])
        for shape_id, prim_id in [*t_of, (0, 79), (1, 0), (2, 0), (3, 0)]:
            alone = caster.cast(single(scene, shape_id, prim_id), *ray)
            assert t_of.get((shape_id, prim_id), np.inf) == alone.t[0]
            kinds.add((shape_id, bool(alone.hit[0])))
        assert [each["t"] for each in hits] == sorted(t_of.values())
        assert (found["hit"] is not None) == bool(hits)
        assert not hits or all(hits[0][name] == found["hit"][name] for name in ("shape_id", "prim_id"))
    assert len(kinds) >= 3


def test_a_ray_through_an_edge_is_decided_by_integers(capsys):
    path = str(SCENES / "shared-edges-cube.toml")
    on_edge, other = probe(caster.load_scene(path).with_film(width=15, height=15), 7, 7)["alone"][:2]
    assert on_edge["t"] == other["t"] == 1.0 and on_edge["t_off"] is None
    assert main(["probe", path, "7", "7", "--size", "15", "15"]) == 0
    assert "integers: undecided in float64" in capsys.readouterr().out


def test_of_many_primitives_those_that_are_hit_are_shown(here, capsys):
    (here / "s.toml").write_text(MESH.replace("subdivisions = 1", "subdivisions = 4"))
    found = probed(capsys, 5, 4)
    assert found["tried"]["prims"] == 20 * 4**4 + 3
    assert found["alone"][0].items() >= {k: v for k, v in found["hit"].items() if k in ("t", "prim_id")}.items()
    hits = [each["shape"] for each in found["alone"] if each["t"] is not None]
    assert hits.count("mesh") == 2  # a closed mesh: in and out

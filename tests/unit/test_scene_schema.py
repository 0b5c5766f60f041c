"""The JSON Schema of scenes accepts and refuses the same as the model."""

import json
import tomllib

import jsonschema
import pytest

from caster.description.errors import SceneError
from caster.scene.files import scene_from_text, scene_schema

SCENE = """
[film]
width = 16
height = 9
crop = [0, 0, 4, 4]
[camera]
type = "pinhole"
eye = [0, 0.5, "0x1.8p+1"]
look_at = [0, 0, 0]
fov = 40
[shading]
shadows = true
[[light]]
type = "point"
position = [2, 3, 2]
intensity = [10, 10, 10]
[material.red]
reflectance = [0.6, 0.1, 0.1]
[[shape]]
type = "sphere"
radius = 1
material = "red"
to_world = { scale = 2 }
[[shape]]
type = "plane"
normal = [0, 1, 0]
offset = -1
[[shape]]
type = "triangle"
vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
to_world = [{ translate = [0, 0, 1] }, { rotate = { axis = [1, 0, 0], degrees = 5 } }, { scale = [1, 2, 3] }]
[check.depth]
ratio = 2
"""


@pytest.fixture(scope="module")
def validator():
    schema = json.loads(json.dumps(scene_schema()))
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def test_a_valid_scene_passes(validator):
    scene = scene_from_text(SCENE)
    for data in (tomllib.loads(SCENE), json.loads(scene.canonical_json()), tomllib.loads(scene.to_toml())):
        validator.validate(data)
        validator.validate({"$schema": "scene.schema.json", **data})


WRONG = [
    ("radius = 1", "radius = -1"),
    ("radius = 1", "radus = 1"),
    ("radius = 1", 'radius = "1"'),
    ('type = "sphere"', 'type = "shpere"'),
    ("fov = 40", "fov = 180"),
    ("width = 16", "width = 0"),
    ("width = 16", "width = 1.5"),
    ("[0.6, 0.1, 0.1]", "[0.6, 0.1, 1.1]"),
    ("[2, 3, 2]", "[2, 3]"),
    ("shadows = true", "shadows = 1"),
    ("{ scale = 2 }", "{ scale = 2, translate = [1, 0, 0] }"),
    ("{ scale = 2 }", "{}"),
    ("crop = [0, 0, 4, 4]", "crop = [0, 0, 4]"),
    ("eye =", "ey ="),
    ("ratio = 2", "ratio = 0"),
]


@pytest.mark.parametrize(("right", "wrong"), WRONG)
def test_what_the_model_refuses_the_schema_refuses(validator, right, wrong):
    assert right in SCENE
    text = SCENE.replace(right, wrong, 1)
    with pytest.raises(SceneError):
        scene_from_text(text)
    assert not validator.is_valid(tomllib.loads(text))

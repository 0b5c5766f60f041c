"""Any scene file gives a scene or a plain message, without traceback or jargon."""

import copy
import json

from hypothesis import given, settings
from hypothesis import strategies as st

from caster.description.errors import SceneError
from caster.scene.files import scene_from_text

SCENE = {
    "film": {"width": 8, "height": 8, "crop": [0, 0, 4, 4]},
    "camera": {"type": "pinhole", "eye": [0, 0, 5], "look_at": [0, 0, 0], "fov": 40, "fov_axis": "y"},
    "shading": {"shadows": True},
    "light": [
        {"type": "point", "position": [0, 1, 0], "intensity": [1, 1, 1]},
        {"type": "directional", "direction": [0, 1, 0], "irradiance": [1, 1, 1]},
    ],
    "material": {"red": {"reflectance": [1, 0, 0], "two_sided": False}},
    "shape": [
        {"type": "sphere", "center": [0, 0, 0], "radius": 1, "material": "red", "name": "ball"},
        {"type": "torus", "major_radius": 1, "segments": 8, "face_normals": True},
        {"type": "triangle", "vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]]},
        {"type": "plane", "normal": [0, 1, 0], "offset": 0},
        {"type": "cube", "to_world": [{"rotate": {"axis": [1, 0, 0], "degrees": 5}}, {"scale": [1, 2, 3]}]},
        {"type": "disk", "to_world": {"look_at": {"origin": [0, 0, 0], "target": [1, 1, 1]}}},
    ],
    "check": {"depth": {"ratio": 2}},
}
JARGON = ("Input should", "something else", "ydantic", "validation", "Value error", "Traceback", "NoneType", "<class")

words = st.sampled_from(
    ["type", "shape", "shapes", "light", "sphere", "mesh", "file", "pinhole", "up", "red", "", "\x00", "a\nb", "0x1p3"]
)
leaves = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    words,
    st.text(max_size=4),
    st.just(10**400),
    st.just("\ud800"),
)
values = st.recursive(leaves, lambda v: st.lists(v, max_size=4) | st.dictionaries(words, v, max_size=3), max_leaves=6)


def places(value, path=()):
    """Every path into nested data."""
    yield path
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield from places(item, (*path, key))


@st.composite
def damaged_scenes(draw):
    data = copy.deepcopy(SCENE)
    for _ in range(draw(st.integers(1, 3))):
        *path, key = draw(st.sampled_from([path for path in places(data) if path]))
        table = data
        for step in path:
            table = table[step]
        damage = draw(st.sampled_from(["replace", "remove", "add"]))
        if damage == "remove":
            del table[key]
        elif damage == "add" and isinstance(table, dict):
            table[draw(words)] = draw(values)
        else:
            table[key] = draw(values)
        if not data:
            break
    return data


@settings(derandomize=True, deadline=None, max_examples=150)
@given(damaged_scenes())
def test_a_damaged_scene_is_a_scene_or_is_reported_in_the_words_of_the_field(data):
    try:
        scene = scene_from_text(json.dumps(data, indent=1), "json", "x.json")
    except SceneError as error:
        said = str(error)
        assert not [word for word in JARGON if word in said], said
        heads = [line for line in said.splitlines() if line.startswith("x.json:")]
        assert heads and len(said.splitlines()) == 3 * len(heads), said
        lines = [int(head.split(":")[1]) for head in heads]
        assert lines == sorted(lines)
    else:
        assert scene_from_text(scene.canonical_json(), "json") == scene
        assert scene_from_text(scene.to_toml()) == scene


@settings(derandomize=True, deadline=None, max_examples=200)
@given(st.text(alphabet="[]{}=\"'.,#\n \t\r-+_0x1e5aé", max_size=60), st.sampled_from(["toml", "json"]))
def test_any_text_is_a_scene_or_a_located_error(text, kind):
    try:
        scene_from_text(text, kind, "x")
    except SceneError as error:
        assert str(error).startswith("x:") and not [word for word in JARGON if word in str(error)]

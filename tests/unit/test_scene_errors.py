"""What users read when a scene file is wrong: where, what was expected, what was found, to the letter."""

import json

import pytest

from caster.description.errors import SceneError
from caster.scene.files import scene_from_text

CAMERA = """\
[camera]
type = "pinhole"
eye = [0, 0, 5]
look_at = [0, 0, 0]
"""  # lines 1 to 4


def errors(text, kind="toml"):
    with pytest.raises(SceneError) as caught:
        scene_from_text(text, kind, "scenes/x.toml")
    return str(caught.value)


def test_an_error_shows_where_it_is_and_the_line_itself():
    lid = '[[shape]]\ntype = "sphere"\nname = "lid"\nradius = -0.5  # inside out\n'
    assert errors(CAMERA + lid) == (
        'scenes/x.toml:8:1: shapes[0] (sphere "lid"): radius must be > 0, got -0.5\n'
        "  8 | radius = -0.5  # inside out\n"
        "    | ^^^^^^"
    )


def shape(kind, line):
    return f'{CAMERA}[[shape]]\ntype = "{kind}"\n{line}\n'  # the line is line 7


def camera(kind, line):
    return f'[camera]\ntype = "{kind}"\neye = [0, 0, 5]\n{line}\n'  # the line is line 4


ONE_LINERS = [
    ("typo", shape("sphere", "radus = 1"), "7:1: shapes[0] (sphere): radus is an unknown key, did you mean 'radius'?"),
    ("no idea", shape("sphere", "qqq = 1"), "7:1: shapes[0] (sphere): qqq is an unknown key"),
    ("top level", CAMERA + "[flim]\n", "5:1: scene: flim is an unknown key, did you mean 'film'?"),
    ("plural", CAMERA + "[lihgts]\n", "5:1: scene: lihgts is an unknown key, did you mean 'light'?"),
    ("both spellings", shape("cube", "[[shapes]]"), "7:1: scene: shapes is an unknown key, did you mean 'shape'?"),
    (
        "no axis",
        shape("cylinder", "p0 = [1, 2, 3]\np1 = [1, 2, 3]"),
        "5:1: shapes[0] (cylinder): p0 and p1 must be different points, got [1.0, 2.0, 3.0] for both",
    ),
    (
        "a date",
        shape("sphere", "center = 1979-05-27"),
        "7:1: shapes[0] (sphere): center must be 3 numbers [x, y, z], got 1979-05-27",
    ),
    (
        "nan",
        shape("sphere", "center = [0, nan, 0]"),
        "7:14: shapes[0] (sphere): center[1] must be a finite number, got nan",
    ),
    (
        "deep inside",
        shape("triangle", "vertices = [[0, 0, 0], [1, 0, true], [0, 1, 0]]"),
        "7:31: shapes[0] (triangle): vertices[1][2] must be a finite number, got true",
    ),
    (
        "too few",
        shape("triangle", "vertices = [[0, 0, 0]]"),
        "7:1: shapes[0] (triangle): vertices must be 3 points, got 1: [[0, 0, 0]]",
    ),
    (
        "a missing key is told at the header",
        CAMERA + '\n  [[shape]]\ntype = "triangle"\n',
        "6:3: shapes[0] (triangle): needs the key 'vertices'",
    ),
    (
        "missing file",
        CAMERA + '[[shape]]\ntype = "mesh"\n',
        "5:1: shapes[0] (mesh): needs file, or vertices and faces, got none",
    ),
    ("no camera", "[film]\nwidth = 3\n", "1:1: scene: needs the key 'camera'"),
    ("an empty file", "", "1:1: scene: needs the key 'camera'"),
    (
        "a sum of keys",
        shape("plane", "normal = [0, 0, 1]"),
        "5:1: shapes[0] (plane): needs either offset or point, got neither",
    ),
    (
        "a limit",
        shape("icosphere", "subdivisions = 99"),
        "7:1: shapes[0] (icosphere): subdivisions must be <= 8, got 99",
    ),
    ("a word", CAMERA + 'fov_axis = "diagnal"\n', "5:1: camera (pinhole): fov_axis must be "),
    (
        "look_at equals eye",
        camera("pinhole", "look_at = [0, 0, 5.0]"),
        "4:1: camera (pinhole): look_at must differ from eye, so that the viewing direction is defined, got [0, 0, 5]",
    ),
    (
        "up along the view",
        camera("pinhole", "look_at = [0, 0, 0]\nup = [0, 0, 3]"),
        "5:1: camera (pinhole): up must be a direction across the view [0, 0, -5], not along it, got [0, 0, 3]",
    ),
    (
        "an empty range",
        camera("pinhole", "look_at = [0, 0, 0]\nnear = 1\nfar = 1"),
        "1:1: camera (pinhole): near must be < far, got near 1.0 and far 1.0",
    ),
    (
        "the default up along the view",
        camera("pinhole", "direction = [0, 2, 0]"),
        "1:1: camera (pinhole): up must be a direction across the view [0, 1, 0], not along it, got [0, 1, 0]",
    ),
    (
        "up without a direction",
        camera("fisheye", "direction = [1, 0, 0]\nup = [0, 0, 0]"),
        "5:1: camera (fisheye): up must be a direction across the view [1, 0, 0], not along it, got [0, 0, 0]",
    ),
    (
        "no view",
        camera("pinhole", "fov = 30"),
        "1:1: camera (pinhole): direction or look_at is required, exactly one of the two, got neither",
    ),
    (
        "two views",
        camera("pinhole", "look_at = [0, 0, 0]\ndirection = [0, 0, 1]"),
        "5:1: camera (pinhole): direction or look_at is required, exactly one of the two, got both",
    ),
    (
        "a view too long",
        camera("pinhole", "look_at = [0, 0, 1]\n")
        .replace("[0, 0, 5]", "[-1.7e308, 0, 0]")
        .replace("= [0, 0, 1]", "= [1.7e308, 0, 1]"),
        "4:1: camera (pinhole): look_at must be nearer to eye, at a finite distance, got [1.7e+308, 0, 1]",
    ),
    (
        "a crop outside",
        CAMERA + "[film]\nwidth = 8\nheight = 8\ncrop = [0, 0, 9, 8]\n",
        "8:1: film: crop must lie inside the film, x1 <= 8 and y1 <= 8, got [0, 0, 9, 8]",
    ),
    (
        "an empty crop",
        CAMERA + "[film]\ncrop = [4, 0, 4, 8]\n",
        "6:1: film: crop must hold at least one pixel, x0 < x1 and y0 < y1, got [4, 0, 4, 8]",
    ),
    ("a crop left of it", CAMERA + "[film]\ncrop = [-1, 0, 4, 8]\n", "6:9: film: crop[0] must be >= 0, got -1"),
    (
        "an axis without direction",
        shape("cube", "to_world = [{ rotate = { axis = [0, 0, 0], degrees = 9 } }]"),
        "7:26: shapes[0] (cube): to_world[0].rotate.axis must be a direction, so not all zero, got [0, 0, 0]",
    ),
    (
        "a singular scale",
        shape("cube", "to_world = [{ scale = [1, 0, 1] }]"),
        "7:1: shapes[0] (cube): to_world must be invertible, but its matrix is singular",
    ),
    (
        "a singular matrix",
        shape("cube", "to_world = { matrix = [[1, 2, 0, 0], [2, 4, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]] }"),
        "7:1: shapes[0] (cube): to_world must be invertible, but its matrix is singular",
    ),
    (
        "a projective matrix",
        shape("cube", "to_world = { matrix = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1, 1]] }"),
        "7:14: shapes[0] (cube): to_world.matrix must end in the row [0, 0, 0, 1], got [0, 0, 1, 1]",
    ),
    (
        "an overflow",
        shape("cube", "to_world = [{ scale = 1e200 }, { scale = 1e200 }]"),
        "7:1: shapes[0] (cube): to_world must stay finite, but its steps together overflow",
    ),
    (
        "two keys in a step",
        shape("cube", "to_world = [{ scale = 2, translate = [1, 0, 0] }]"),
        "7:13: shapes[0] (cube): to_world[0] must have one key, got translate and scale: write a list of steps instead",
    ),
    (
        "a step of nothing",
        shape("cube", "to_world = [{}]"),
        "7:13: shapes[0] (cube): to_world[0] needs one of the keys translate, rotate, scale, look_at or matrix",
    ),
    (
        "an unknown step",
        shape("cube", "to_world = [{ trnslate = [1, 2, 3] }]"),
        "7:15: shapes[0] (cube): to_world[0].trnslate is an unknown key, did you mean 'translate'?",
    ),
    (
        "no step at all",
        shape("cube", "to_world = 3"),
        "7:1: shapes[0] (cube): to_world must be a list of steps such as {translate = [1, 0, 0]}, got 3",
    ),
    (
        "a degenerate look_at step",
        shape("cube", "to_world = { look_at = { origin = [1, 2, 3], target = [1, 2, 3] } }"),
        "7:46: shapes[0] (cube): to_world.look_at.target must differ from origin, so that "
        "the viewing direction is defined, got [1, 2, 3]",
    ),
    (
        "an unknown shape",
        CAMERA + '[[shape]]\ntype = "shpere"\n',
        "6:1: shapes[0] (shpere): unknown shape type \"shpere\", did you mean 'sphere'? (known: sphere, plane, ",
    ),
    (
        "a shape without type",
        CAMERA + "[[shape]]\nradius = 1\n",
        "5:1: shapes[0]: needs the key 'type': sphere, plane, ",
    ),
    ("a number for a type", CAMERA + "[[shape]]\ntype = 3\n", "6:1: shapes[0]: unknown shape type 3 (known: sphere, "),
    (
        "an unknown camera",
        camera("pinhol", ""),
        "2:1: camera (pinhol): unknown camera type \"pinhol\", did you mean 'pinhole'? (known: pinhole, orthographic, ",
    ),
    ("an unknown light", CAMERA + '[[light]]\ntype = "spot"\n', '6:1: lights[0] (spot): unknown light type "spot"'),
    ("shapes as a table", CAMERA + '[shape]\ntype = "cube"\n', "5:1: scene: shape must be a list, got a table"),
    ("a number for a table", "film = 3\n" + CAMERA, "1:1: film: must be a table, got 3"),
    (
        "bright materials",
        CAMERA + "[material.white]\nreflectance = [1, 1, 2]\n",
        "6:22: materials.white: reflectance[2] must be <= 1, got 2",
    ),
    (
        "an unknown texture",
        CAMERA + '[material.m]\nreflectance = { type = "chekerboard" }\n',
        "6:17: materials.m: reflectance unknown reflectance type \"chekerboard\", did you mean 'checkerboard'?",
    ),
    (
        "an unknown filter",
        CAMERA + '[material.m]\nreflectance = { type = "bitmap", data = [[[0, 0, 0]]], filter = "cubic" }\n',
        '6:56: materials.m: reflectance.filter must be "bilinear" or "nearest", got "cubic"',
    ),
    (
        "a bitmap without pixels",
        CAMERA + '[material.m]\nreflectance = { type = "bitmap" }\n',
        "6:1: materials.m: reflectance needs either file or data, got neither",
    ),
    (
        "a ragged bitmap",
        CAMERA + '[material.m]\nreflectance = { type = "bitmap", data = [[[0, 0, 0]], [[0, 0, 0], [1, 1, 1]]] }\n',
        "6:34: materials.m: reflectance.data must have rows of the same length, got [1, 2]",
    ),
    (
        "a texture without uv",
        shape("icosphere", 'material = "m"') + '[material.m]\nreflectance = { type = "checkerboard" }\n',
        "7:1: shapes[0] (icosphere): material names a material with a texture, but its triangles have no uv: give it a",
    ),
    (
        "an unknown material",
        shape("cube", 'material = "rde"') + "[material.red]\n[material.blue]\n",
        "7:1: shapes[0] (cube): material must be one of the materials of this scene, got \"rde\", did you mean 'red'?",
    ),
    (
        "a material without any",
        shape("cube", 'material = "red"'),
        '7:1: shapes[0] (cube): material must be one of the materials of this scene, got "red"; '
        "add a table [material.red]",
    ),
    (
        "a name twice",
        shape("cube", 'name = "a"\n[[shape]]\ntype = "disk"\nname = "a"'),
        '10:1: shapes[1] (disk "a"): name must differ from that of shapes[0], got "a" again',
    ),
    (
        "the name of a nameless one",
        shape("cube", 'name = "shape-1"\n[[shape]]\ntype = "disk"'),
        '8:1: shapes[1] (disk): name must differ from that of shapes[0], got "shape-1" again',
    ),
    (
        "an unprintable name",
        shape("cube", 'name = "a\\nb"'),
        '7:1: shapes[0] (cube "a\\nb"): name must be printable characters, got "a\\nb"',
    ),
    (
        "a check of nothing",
        CAMERA + "[check.dept]\nratio = 2\n",
        "5:1: checks.dept: unknown AOV, did you mean 'depth'? (known: ",
    ),
    ("syntax", "[film]\nwidth 3\n", "2:7: not valid TOML: expected '=' after a key in a key/value pair"),
    ("syntax at the end", "[film]\nwidth =", "2:8: not valid TOML: invalid value"),
    ("a key twice", "[film]\nwidth = 3\nwidth = 4\n", "3:10: not valid TOML: cannot overwrite a value"),
    (
        "a bare point",
        "[film]\nwidth = .5\n",
        "2:9: not valid TOML: invalid value: a number needs a digit before its point",
    ),
]


@pytest.mark.parametrize(("text", "says"), [case[1:] for case in ONE_LINERS], ids=[case[0] for case in ONE_LINERS])
def test_one_mistake_gives_one_located_sentence(text, says):
    said = errors(text)
    assert said.startswith(f"scenes/x.toml:{says}")
    assert len(said.splitlines()) == 3, said


def test_all_errors_of_a_file_come_at_once_in_the_order_of_their_lines():
    text = """\
[[shape]]
type = "sphere"
radus = 1
material = "gold"

[camera]
type = "pinhole"
eye = [0, 0, 5]
look_at = [0, 0, 5]

[[shape]]
type = "mesh"
file = "../out/of/reach.ply"

[film]
width = 0
"""
    heads = [line for line in errors(text).splitlines() if line.startswith("scenes/")]
    assert [head.split(": ")[0] for head in heads] == [f"scenes/x.toml:{line}:1" for line in (3, 4, 9, 13, 16)]


def test_a_default_that_does_not_fit_is_reported_beside_another_error():
    said = errors('[camera]\ntype = "pinhole"\neye = [0, 0, "x"]\ndirection = [0, 1, 0]\nnear = -1\n')
    assert "eye[2]" in said and "near" in said


def test_a_long_line_is_shown_around_the_error():
    text = shape("sphere", f"center = [{'0' * 1}{' ' * 300}, nan, 0]")
    head, line, marks = errors(text).splitlines()
    assert head.startswith("scenes/x.toml:7:314: ")
    assert len(line) < 120 and line[marks.index("^") :].startswith("nan")


def test_marks_stand_below_the_value_after_tabs_and_wide_letters():
    text = CAMERA + '\t["é"]\n'
    assert errors(text).splitlines() == [
        "scenes/x.toml:5:2: scene: é is an unknown key",
        "  5 | " + '\t["é"]',
        "    | \t^^^^^",
    ]


def test_windows_line_ends_move_nothing():
    text = (CAMERA + "fov = 0\n").replace("\n", "\r\n")
    assert errors(text).splitlines()[1:] == ["  5 | fov = 0", "    | ^^^"]


JSON = [
    (
        '{"camera": {"type": "pinhole", "eye": [0, 0, 5], "look_at": [0, 0, 5]}}',
        "1:50: camera (pinhole): look_at must differ from eye",
    ),
    (
        '{\n "camera": {"type": "panorama",\n  "eye": [0, NaN, 5],\n  "direction": [0, 0, 1]}}',
        "3:14: camera (panorama): eye[1] must be a finite number, got nan",
    ),
    (
        '{\n "camera": {\n  "type": "fisheye", "eye": [0, 0, 5], "direction": [0, 0, 1], "fv": 3}}',
        "3:64: camera (fisheye): fv is an unknown key, did you mean 'fov'?",
    ),
    ("[1]", "1:1: scene: must be a table, got [1]"),
    ('{"film": {"width": 3,}}', "1:22: not valid JSON: "),
    ('{"film"\n', "2:1: not valid JSON: expecting ':' delimiter"),
]


@pytest.mark.parametrize(("text", "says"), JSON, ids=[text[-12:] for text, _ in JSON])
def test_json_errors_are_located_too(text, says):
    said = errors(text, "json")
    assert said.startswith(f"scenes/x.toml:{says}")
    assert len(said.splitlines()) == 3, said


@pytest.mark.parametrize(("text", "column"), [('{"film":', 9), ('{"film": {}', 12), ("[1, ", 5), ("", 1)])
def test_an_error_at_the_end_of_a_line_has_one_mark_behind_it(text, column):
    head, line, mark = errors(text, "json").split("\n")
    assert head.startswith(f"scenes/x.toml:1:{column}: not valid JSON: ")
    assert line == f"  1 | {text}" and mark == "    | " + " " * (column - 1) + "^"


def test_a_key_that_is_twice_in_a_json_table_is_an_error():
    scene = {"camera": {"type": "panorama", "eye": [0, 0, 0], "direction": [0, 0, 1]}}
    text = json.dumps(scene).replace('"eye"', '"eye": [1, 1, 1], "eye"')
    assert errors(text, "json").startswith("scenes/x.toml: not valid JSON: a table has the key 'eye' twice")


@pytest.mark.parametrize(("text", "kind"), [("a = " + "[" * 3000, "toml"), ("[" * 100_000, "json")])
def test_a_text_nested_too_deeply_is_an_error(text, kind):
    assert "nested too deeply" in errors(text, kind)

"""Bad input to `caster` gives a located message and an exit code, and leaves no file behind."""

import pytest

from caster.__main__ import main

pytestmark = pytest.mark.usefixtures("warm")

CAMERA = '[camera]\ntype = "pinhole"\neye = [0, 0, 5]\nlook_at = [0, 0, 0]\n'
SPHERE = '[[shape]]\ntype = "sphere"\n'
MESH = '[[shape]]\ntype = "mesh"\nfile = "m.obj"\n'

# What is wrong: (scene text, mesh files beside it, exit code, the message after the scene's name). Errors of the scene
# text itself are in test_scene_errors.py, those of mesh files in test_mesh_*.py.
BAD_SCENES = {
    "an unknown key": (CAMERA + "foov = 40\n", {}, 2, ":5:1: camera (pinhole): foov is an unknown key, did you mean"),
    "a broken mesh": (
        CAMERA + MESH,
        {"m.obj": b"v 0 0 0\nf 1 2\n"},
        2,
        ":7:1: shapes[0] (mesh): file cannot be used: m.obj:2: a face needs at least 3",
    ),
    "a missing mesh": (CAMERA + MESH, {}, 4, ":7:1: shapes[0] (mesh): file cannot be used: "),
    "numbers that overflow together": (
        CAMERA + SPHERE + "center = [1e308, 0, 0]\nto_world = { scale = 100 }\n",
        {},
        2,
        ": shapes[0] (sphere): must stay finite in world space",
    ),
    "an axis too short to have a direction": (
        CAMERA + '[[shape]]\ntype = "cylinder"\nname = "tube"\np1 = [0, 0, 1e-310]\n',
        {},
        2,
        ': shapes[0] (cylinder "tube"): must stay finite in world space',
    ),
    "no scene": (None, {}, 4, ": cannot read this scene file: No such file or directory"),
}


def put(here, text, files=None):
    if text is not None:
        (here / "s.toml").write_text(text)
    for name, content in (files or {}).items():
        (here / name).write_bytes(content)


def refused(capsys, code, *argv):
    """What the command said on stderr, having ended with `code` and no result."""
    assert main(argv) == code
    said = capsys.readouterr()
    assert said.out == "" and "Traceback" not in said.err
    return said.err


@pytest.mark.parametrize("what", BAD_SCENES)
def test_a_bad_scene_is_refused_with_its_line_by_every_command(here, capsys, what):
    text, files, code, message = BAD_SCENES[what]
    put(here, text, files)
    said = refused(capsys, code, "render", "s.toml")
    assert said.startswith("s.toml" + message)
    assert refused(capsys, code, "probe", "s.toml", "0", "0") == said
    assert main(["check", "s.toml"]) == code and capsys.readouterr().out.split() == said.split()
    assert not (here / "s.exr").exists()


def test_check_reports_all_errors_of_all_files(here, capsys):
    put(here, CAMERA + "fov = 0\n" + SPHERE + "radius = -1\n")
    (here / "good.toml").write_text(CAMERA)
    assert main(["check", "s.toml", "good.toml", "no.toml"]) == 2
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(": ")[0] for line in lines if ".toml" in line] == [
        "s.toml:5:1",
        "s.toml:8:1",
        "good.toml",
        "no.toml",
    ]
    assert main(["check", "good.toml", "no.toml"]) == 4
    assert main(["check", "good.toml"]) == 0


# ---- options ----


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--size", "0", "8"], "--size 0 8: film: width must be >= 1, got 0"),
        (["--size", "8", "99999"], "--size 8 99999: film: height must be <= 65536, got 99999"),
        (["--crop", "0", "0", "9", "300"], "--crop 0 0 9 300: film: crop must lie inside the film"),
        (["--aov", "dept"], "aov 'dept': unknown, did you mean 'depth'?; known are hit, depth, "),
        (["--aov", ""], "aov '': no name between two commas; known are hit, depth, "),
        (["-o", "s.png"], "-o s.png: expected a name that ends in .exr"),
    ],
    ids=" ".join,
)
def test_a_wrong_option_is_2_and_nothing_is_written(here, capsys, options, message):
    put(here, CAMERA + SPHERE)
    assert refused(capsys, 2, "render", "s.toml", *options).startswith(message)
    assert [path.name for path in here.iterdir()] == ["s.toml"]


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        ([], "render    render a scene to an EXR file"),
        (["rendr"], "invalid choice: 'rendr', did you mean 'render'? (choose from"),
        (["render", "s.toml", "--siz", "8", "8"], "unrecognized arguments: --siz 8 8, did you mean '--size'?"),
        (["probe", "1", "2", "s.toml"], "argument Y: expected SCENE X Y in this order"),
        (["render"], "the following arguments are required: SCENE"),
        (["render", "s.toml", "--size", "8"], "argument --size: expected 2 arguments"),
        (["render", "s.toml", "--size", "8", "x"], "argument --size: invalid int value: 'x'"),
        (["render", "s.toml", "--threads", "0"], "argument --threads: expected a whole number >= 1, got '0'"),
        (["render", "s.toml", "--threads", "two"], "argument --threads: expected a whole number >= 1, got 'two'"),
        (["render", "s.toml", "--threads", "1000000"], "--threads: expected at most 1024 threads, got 1000000"),
        (["render", "s.toml", "--colour"], "unrecognized arguments: --colour"),
        (["render", "s.toml", "--expl"], "unrecognized arguments: --expl"),
        (["probe", "s.toml", "1"], "the following arguments are required: Y"),
        (
            ["probe", "s.toml", "1", "1.5"],
            "argument Y: expected SCENE X Y in this order, such as scene.toml 160 120, with whole numbers; got '1.5'",
        ),
        (["check"], "the following arguments are required: SCENE"),
    ],
    ids=" ".join,
)
def test_wrong_usage_is_2_and_states_how_to_call_it(capsys, argv, message):
    said = refused(capsys, 2, *argv)
    assert message in said and (said.count("\n") == 2 or not argv)


# ---- files that cannot be read or written ----


def test_an_output_that_cannot_be_written_is_reported_before_the_scene_is_rendered(here, capsys, monkeypatch):
    put(here, CAMERA + SPHERE)
    monkeypatch.setattr("caster.rendering.images.trace_film", None)  # calling it would end with 70
    refused(capsys, 4, "render", "s.toml", "-o", "no/s.exr")

"""Bad input to `caster`: a sentence that says where and what, its exit code, and nothing left behind."""

import struct
import subprocess
import sys
from pathlib import Path

import pytest

from caster.__main__ import main

pytestmark = pytest.mark.usefixtures("warm")

ROOT = Path(__file__).resolve().parents[2]
CAMERA = '[camera]\ntype = "pinhole"\neye = [0, 0, 5]\nlook_at = [0, 0, 0]\n'
SPHERE = '[[shape]]\ntype = "sphere"\n'
MESH = '[[shape]]\ntype = "mesh"\nfile = "m.{}"\n'
OBJ, PLY = MESH.format("obj"), MESH.format("ply")

TRIANGLE_PLY = (
    b"""ply
format binary_little_endian 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
"""
    + struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
    + struct.pack("<Biii", 3, 0, 1, 2)
)

# What is wrong -> (scene text, mesh files beside it, what the message says after the scene's name).
BAD_SCENES = {
    "a syntax error": (CAMERA + "fov = \n", {}, ":5:7: not valid TOML: invalid value"),
    "an unknown key": (
        CAMERA + "foov = 40\n",
        {},
        ":5:1: camera (pinhole): foov is an unknown key, did you mean 'fov'?",
    ),
    "a wrong type": (
        CAMERA + SPHERE + 'radius = "big"\n',
        {},
        ':7:1: shapes[0] (sphere): radius must be a length > 0, got "big"',
    ),
    "a negative radius": (
        CAMERA + SPHERE + "radius = -0.5\n",
        {},
        ":7:1: shapes[0] (sphere): radius must be a length > 0, got -0.5\n  7 | radius = -0.5\n",
    ),
    "a degenerate look_at": (
        CAMERA.replace("[0, 0, 0]", "[0, 0, 5]"),
        {},
        ":4:1: camera (pinhole): look_at must be another point than eye",
    ),
    "fov 0": (CAMERA + "fov = 0\n", {}, ":5:1: camera (pinhole): fov must be an angle > 0 and < 180 degrees, got 0"),
    "fov 180": (
        CAMERA + "fov = 180\n",
        {},
        ":5:1: camera (pinhole): fov must be an angle > 0 and < 180 degrees, got 180",
    ),
    "an unknown shape": (
        CAMERA + '[[shape]]\ntype = "spere"\n',
        {},
        ":6:1: shapes[0] (spere): unknown shape type \"spere\", did you mean 'sphere'?",
    ),
    "a zero-size film": (CAMERA + "[film]\nwidth = 0\n", {}, ":6:1: film: width must be >= 1, got 0"),
    "NaN in the normals of a mesh": (
        CAMERA + OBJ,
        {"m.obj": b"v 0 0 0\nvn 1 nan 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"},
        ":7:1: shapes[0] (mesh): file cannot be used: m.obj:2: vn must be finite numbers",
    ),
    "an index out of range": (
        CAMERA + OBJ,
        {"m.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n"},
        ":7:1: shapes[0] (mesh): file cannot be used: m.obj:4: ",
    ),
    "an empty mesh": (
        CAMERA + PLY,
        {"m.ply": b""},
        ":7:1: shapes[0] (mesh): file cannot be used: the file is empty (0 bytes)",
    ),
    "a mesh of no faces": (
        CAMERA + OBJ,
        {"m.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"},
        ":7:1: shapes[0] (mesh): file cannot be used: the mesh has no faces",
    ),
    "a face with two vertices": (
        CAMERA + OBJ,
        {"m.obj": b"v 0 0 0\nv 1 0 0\nf 1 2\n"},
        ":7:1: shapes[0] (mesh): file cannot be used: m.obj:3: a face needs at least 3 vertices, got 2",
    ),
    "a truncated PLY": (
        CAMERA + PLY,
        {"m.ply": TRIANGLE_PLY[:-5]},
        ":7:1: shapes[0] (mesh): file cannot be used: truncated",
    ),
    "numbers that overflow together": (
        CAMERA + SPHERE + "center = [1e308, 0, 0]\nto_world = { scale = 100 }\n",
        {},
        ": shapes[0] (sphere): must stay finite in world space",
    ),
    "a mesh without a corner that stays finite": (
        CAMERA + OBJ + "to_world = { scale = 1e100 }\n",
        {"m.obj": b"v 1e300 1e300 1e300\nv 2e300 1e300 1e300\nv 1e300 2e300 1e300\nf 1 2 3\n"},
        ": shapes[0] (mesh): must stay finite in world space",
    ),
    "an axis too short to have a direction": (
        CAMERA + '[[shape]]\ntype = "cylinder"\nname = "tube"\np1 = [0, 0, 1e-310]\n',
        {},
        ': shapes[0] (cylinder "tube"): must stay finite in world space',
    ),
    "a mesh path outside reach": (
        CAMERA + PLY.replace("m.ply", "../m.ply"),
        {"../m.ply": TRIANGLE_PLY},
        ":7:1: shapes[0] (mesh): file must lie in the scene's folder, below it, or below a folder given by "
        '--mesh-dir, got "../m.ply": add --mesh-dir ',
    ),
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder to work in, with one above it that is ours too."""
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    return work


def put(folder, text, files=None):
    (folder / "s.toml").write_text(text)
    for name, content in (files or {}).items():
        (folder / name).write_bytes(content)


def refused(capsys, code, *argv):
    """What the command said on stderr, having ended with `code` and no result."""
    assert main(argv) == code
    said = capsys.readouterr()
    assert said.out == "" and "Traceback" not in said.err
    return said.err


@pytest.mark.parametrize("what", BAD_SCENES)
def test_render_refuses_a_bad_scene_with_its_line(folder, capsys, what):
    text, files, message = BAD_SCENES[what]
    put(folder, text, files)
    assert refused(capsys, 2, "render", "s.toml").startswith("s.toml" + message)
    assert not (folder / "s.exr").exists()


@pytest.mark.parametrize("what", BAD_SCENES)
def test_check_and_probe_say_the_same_as_render(folder, capsys, what):
    put(folder, *BAD_SCENES[what][:2])
    said = refused(capsys, 2, "render", "s.toml")
    assert refused(capsys, 2, "probe", "s.toml", "0", "0") == said
    assert main(["check", "s.toml"]) == 2
    assert capsys.readouterr().out == said


def test_the_mesh_of_the_truncated_case_is_good_when_it_is_whole(folder, capsys):
    put(folder, CAMERA + PLY, {"m.ply": TRIANGLE_PLY})
    assert main(["check", "s.toml"]) == 0
    assert capsys.readouterr().out == "s.toml: ok, 1 shapes\n"


def test_a_mesh_dir_brings_a_mesh_into_reach(folder, capsys):
    put(folder, *BAD_SCENES["a mesh path outside reach"][:2])
    said = refused(capsys, 2, "render", "s.toml")
    hint = said.splitlines()[0].rpartition("add ")[2].split()
    assert hint[0] == "--mesh-dir"
    assert main(["check", "s.toml", *hint]) == 0
    assert main(["check", "--mesh-dir", "elsewhere", "--mesh-dir", str(folder.parent), "s.toml"]) == 0


@pytest.mark.parametrize("command", [["render"], ["probe"], ["check"]], ids=lambda c: c[0])
def test_a_missing_scene_is_4(folder, capsys, command):
    pixel = ["0", "0"] if command == ["probe"] else []
    assert main([*command, "no.toml", *pixel]) == 4
    said = capsys.readouterr()
    assert said.out + said.err == "no.toml: cannot read this scene file: No such file or directory\n"


def test_a_missing_mesh_is_4(folder, capsys):
    put(folder, CAMERA + PLY)
    said = refused(capsys, 4, "render", "s.toml")
    assert said.startswith("s.toml:7:1: shapes[0] (mesh): file cannot be used: ")
    assert "No such file or directory" in said


def test_check_reports_all_errors_of_all_files(folder, capsys):
    put(folder, CAMERA + "fov = 0\n" + SPHERE + "radius = -1\n")
    (folder / "good.toml").write_text(CAMERA)
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
        (["--crop", "4", "4", "4", "9"], "--crop 4 4 4 9: film: crop must hold at least one pixel"),
        (["--crop", "-1", "0", "4", "9"], "--crop -1 0 4 9: film: crop[0] must be >= 0, got -1"),
        (["--aov", "dept"], "aov 'dept': unknown, did you mean 'depth'?; known are hit, depth, "),
        (["--aov", ""], "aov '': no name between two commas; known are hit, depth, "),
        (["-o", "s.png"], "-o s.png: expected a name that ends in .exr"),
    ],
    ids=" ".join,
)
def test_a_wrong_option_is_2_and_nothing_is_written(folder, capsys, options, message):
    put(folder, CAMERA + SPHERE)
    assert refused(capsys, 2, "render", "s.toml", *options).startswith(message)
    assert [path.name for path in folder.iterdir()] == ["s.toml"]


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        ([], "the following arguments are required: COMMAND"),
        (["rendr"], "invalid choice: 'rendr'"),
        (["render"], "the following arguments are required: SCENE"),
        (["render", "s.toml", "--size", "8"], "argument --size: expected 2 arguments"),
        (["render", "s.toml", "--size", "8", "x"], "argument --size: invalid int value: 'x'"),
        (["render", "s.toml", "--threads", "0"], "argument --threads: expected a whole number >= 1, got '0'"),
        (["render", "s.toml", "--threads", "two"], "argument --threads: expected a whole number >= 1, got 'two'"),
        (["render", "s.toml", "--colour"], "unrecognized arguments: --colour"),
        (["render", "s.toml", "--expl"], "unrecognized arguments: --expl"),
        (["probe", "s.toml", "1"], "the following arguments are required: Y"),
        (["probe", "s.toml", "1", "1.5"], "argument Y: invalid int value: '1.5'"),
        (["check"], "the following arguments are required: SCENE"),
    ],
    ids=" ".join,
)
def test_wrong_usage_is_2_and_states_how_to_call_it(capsys, argv, message):
    said = refused(capsys, 2, *argv)
    assert said.startswith("usage: caster") and message in said


@pytest.mark.parametrize(("x", "y"), [(64, 0), (0, 48), (-1, 0), (0, -1), (10**9, 10**9)])
def test_a_pixel_outside_the_film_is_2(folder, capsys, x, y):
    put(folder, CAMERA + "[film]\nwidth = 64\nheight = 48\n")
    assert refused(capsys, 2, "probe", "s.toml", str(x), str(y)) == (
        f"s.toml: pixel ({x}, {y}): outside the film, expected 0 <= x < 64 and 0 <= y < 48\n"
    )


# ---- files that cannot be read or written ----


def test_an_output_in_no_folder_is_4(folder, capsys):
    put(folder, CAMERA + SPHERE)
    said = refused(capsys, 4, "render", "s.toml", "-o", "no/s.exr")
    assert said == f"{folder}/no/s.exr: cannot write: No such file or directory (folder {folder}/no)\n"
    assert [path.name for path in folder.iterdir()] == ["s.toml"]


def test_an_output_that_is_a_folder_is_4(folder, capsys):
    put(folder, CAMERA + SPHERE)
    (folder / "s.exr").mkdir()
    assert "expected a file to write, this is a folder" in refused(capsys, 4, "render", "s.toml")


def test_an_output_that_cannot_be_written_is_reported_before_the_scene_is_rendered(folder, capsys, monkeypatch):
    put(folder, CAMERA + SPHERE)
    monkeypatch.setattr("caster.rendering.images.trace_film", None)  # calling it would end with 70
    refused(capsys, 4, "render", "s.toml", "-o", "no/s.exr")


def test_a_disk_that_fills_up_leaves_the_older_file_and_no_half_one(folder, capsys, monkeypatch):
    put(folder, CAMERA + SPHERE)
    (folder / "s.exr").write_bytes(b"older")

    def fill_up(self, path):
        Path(path).write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("OpenEXR.File.write", fill_up)
    said = refused(capsys, 4, "render", "s.toml", "--size", "4", "4", "--aov", "hit")
    assert "s.exr: cannot write: No space left on device" in said
    assert sorted(path.name for path in folder.iterdir()) == ["s.exr", "s.toml"]
    assert (folder / "s.exr").read_bytes() == b"older"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "x.exr: no such file"),
        (b"", "x.exr: expected an EXR image, the file is empty (0 bytes)"),
        (b"P6 1 1 255 ", "x.exr: expected an EXR image, the file starts with b'P6 1'"),
        (struct.pack("<II", 20000630, 2) + b"chann", "x.exr: a damaged or truncated EXR (13 bytes)"),
    ],
)
@pytest.mark.parametrize("json", [[], ["--json"]], ids=["text", "json"])
def test_info_on_what_is_no_exr_is_4(folder, capsys, content, message, json):
    if content is not None:
        (folder / "x.exr").write_bytes(content)
    assert refused(capsys, 4, "info", "x.exr", *json).startswith(message)


# ---- the same as a process of its own ----


@pytest.mark.parametrize(
    ("scene", "code", "message"),
    [
        (CAMERA + "foov = 1\n", 2, "s.toml:5:1: camera (pinhole): foov is an unknown key"),
        (None, 4, "s.toml: cannot read this scene file: "),
    ],
)
def test_the_process_ends_with_the_code_and_the_message(folder, scene, code, message):
    if scene:
        put(folder, scene)
    command = [sys.executable, "-m", "caster", "render", "s.toml"]
    run = subprocess.run(
        command, cwd=folder, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False
    )
    assert (run.returncode, run.stdout) == (code, "")
    assert run.stderr.startswith(message) and "Traceback" not in run.stderr

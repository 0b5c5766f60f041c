"""Mistakes of a first hour: each is answered by its cause and a way out, with the right exit code, in few lines."""

from pathlib import Path

import numpy as np
import pytest
from outputs import unfolded

import caster
from caster.__main__ import main as caster_main
from caster.image.channels import write_render
from caster.system.terminal import COMMAND
from mitsuba_ref.__main__ import main as judge_main
from mitsuba_ref.reference import variants

SCENE = """
[film]
width = 16
height = 12
[camera]
type = "pinhole"
eye = [0.5, 0.75, 4]
look_at = [0, 0, 0]
[[shape]]
type = "cube"
"""
SIX_TYPOS = """
[film]
widht = 16
[camera]
type = "pinhole"
eye = [0.5, 0.75]
lookat = [0, 0, 0]
[[shape]]
type = "cubes"
[[shape]]
type = "sphere"
radius = -1
[[shape]]
type = "sphere"
material = "redd"
[material.red]
reflectance = [1, 0, 0]
"""
CANDIDATES = """
import numpy as np
def raises(scene, o, d):
    raise RuntimeError("no such shape")
def two(o, d):
    return np.full(len(o), np.inf), None
def one(scene, o, d):
    return np.full(len(o), np.inf)
def short(scene, o, d):
    return np.full(3, np.inf), None
"""
JUDGE, CASTER = "mitsuba-ref", "caster"

# Command line, exit code, and parts of the answer: the cause, what was expected, the way out.
MISTAKES = [
    (
        "mitsuba-ref validate typos.toml",
        2,
        "'width'",
        "eye must be 3 numbers",
        "'look_at'",
        "'cube'",
        "radius",
        "'red'",
    ),
    ("mitsuba-ref render scene.toml -o a.exr --aov dept", 2, "unknown, did you mean 'depth'?", "hit, depth, normal"),
    (
        "mitsuba-ref compare empty .",
        4,
        "FAIL a.exr empty/a.exr: cannot read this EXR image: No such file",
        "FAIL small.exr",
        "2 images: 0 pass, 2 fail",
    ),
    ("mitsuba-ref compare a.exr .", 2, "expected two files, or two folders; only . is a folder"),
    ("mitsuba-ref rays scene.toml --kind random --bounces 1 -o r", 2, "--kind: not together with --bounces"),
    ("mitsuba-ref rays scene.toml --count 9 --bounces 1 -o r", 2, "--count: expected --kind of aimed rays beside it"),
    ("mitsuba-ref compare . empty", 5, "nothing selected: no .exr file in empty"),
    ("mitsuba-ref validate scene.toml -k 'tea and'", 2, "-k 'tea and': expected parts of names with and, or, not"),
    ("mitsuba-ref compare scene.toml a.exr", 4, "scene.toml: expected an EXR image, got a file that starts with '[fi"),
    ("caster render scene.toml b.exr", 2, "unrecognized arguments: b.exr; an output follows -o, as in -o b.exr"),
    ("mitsuba-ref compare a.exr small.exr", 3, "size: ours is 16 x 12, the reference 8 x 6", "render both at one size"),
    ("mitsuba-ref compare a.exr small.exr --html page", 3, "report: none, as nothing could be compared"),
    (
        "mitsuba-ref validate scene.toml --candidate beginners:raises",
        1,
        "RuntimeError: no such shape",
        "beginners.py:4",
        "replay:",
        "FAIL scene - - - 0.",
    ),
    ("mitsuba-ref validate scene.toml --candidate beginners:two", 1, "2 positional arguments", "function(scene, o, d)"),
    ("mitsuba-ref validate scene.toml --candidate beginners:one", 1, "two arrays (t, n)", "one array of shape (192,)"),
    ("mitsuba-ref validate scene.toml --candidate beginners:short", 1, "t: expected shape (n,) = (192,), got (3,)"),
    ("mitsuba-ref validate scene.toml --candidate numpy:trace", 1, "TypeError", "called as function(scene, o, d)"),
    ("mitsuba-ref validate scene.toml --candidate nope:trace", 2, "no module nope", "looked in {here}", "PYTHONPATH"),
    ("mitsuba-ref validate scene.toml --candidate beginners:nope", 2, "beginners has no 'nope'"),
    ("mitsuba-ref validate scene.toml --candidate beginners:raise", 2, "no 'raise', did you mean 'raises'?"),
    ("mitsuba-ref validate scene.toml --candidate beginners", 2, "module:function, did you mean 'beginners:short'?"),
    ("mitsuba-ref validate scene.toml --candidate mine.py", 2, "module:function, did you mean 'mine:trace'?"),
    ("mitsuba-ref validate scene.toml --candidate trace", 2, "expected package.module:function, or a command such as"),
    ("mitsuba-ref validate scene.toml --candidate-serve ./no", 2, "--candidate-serve './no': there is no program"),
    ("mitsuba-ref validate scene.toml --candidate './nosuch {xml} {exr}'", 2, "there is no program './nosuch' to run"),
    ("mitsuba-ref validate scene.toml --out /proc/x", 4, "/proc/x"),
    ("caster render scene.toml -o /proc/x/a.exr", 4, "cannot write", "/proc"),
    ("mitsuba-ref validate mesh.toml", 4, "missing.ply", "--mesh-dir"),
    ("mitsuba-ref validate", 4, "none is named, and there is no folder 'scenes' here", "--builtin triangles"),
    ("mitsuba-ref validate empty", 5, "no scene file in empty", "--builtin triangles"),
    ("mitsuba-ref validat scene.toml", 2, "'validat', did you mean 'validate'?"),
    ("mitsuba-ref validate scene.toml --siz 8 8", 2, "unrecognized arguments: --siz 8 8, did you mean '--size'?"),
    ("mitsuba-ref validate --builtin triangels", 2, "'triangels', did you mean 'triangles'?", "spheres"),
    ("mitsuba-ref validate builtin:needels", 2, "builtin:needels", "did you mean 'needles'?"),
    ("mitsuba-ref docs internals", 2, "no page 'internals'", "did you mean 'internals/"),
    ("mitsuba-ref probe 8 6 scene.toml", 2, "expected SCENE X Y in this order, such as scene.toml 160 120"),
]
NEED_MITSUBA = [
    "validate scene.toml",
    "validate scene.toml --candidate beginners:one",
    "probe scene.toml 3 3",
    "render scene.toml -o b.exr",
    "stress scale --rays 4",
    "fuzz --examples 1",
    "bench one-sphere --size 16 --alternations 1",
    "judge --scene scene.toml --rays rays.npz --hits hits.npz",
]


@pytest.fixture
def whole_messages():
    """Messages are folded here, as a user sees them."""


@pytest.fixture
def folder(here):
    Path("empty").mkdir()
    for name, text in (
        ("scene.toml", SCENE),
        ("typos.toml", SIX_TYPOS),
        ("beginners.py", CANDIDATES),
        ("mine.py", "def helper(): ...\ndef trace(scene, o, d): ...\n"),
    ):
        Path(name).write_text(text)
    Path("mesh.toml").write_text(SCENE.replace('type = "cube"', 'type = "mesh"\nfile = "missing.ply"'))
    np.savez("rays.npz", rays=np.array([[0, 0, 9, 0, 0, -1, 0, np.inf]]))
    np.savez("hits.npz", t=np.ones(1))
    for name, size in (("a.exr", (16, 12)), ("small.exr", (8, 6))):
        scene = caster.load_scene("scene.toml").with_film(width=size[0], height=size[1])
        write_render(name, scene, [caster.render(scene, ("depth",))], "scene.toml")
    return here


def answer(line: str, capsys) -> tuple[int, str]:
    """The exit code of a command line, and its output with every run of blanks as one."""
    import shlex

    program, *words = shlex.split(line)
    code = (caster_main if program == CASTER else judge_main)(words)
    text = "".join(capsys.readouterr())
    wide = [each for each in text.splitlines() if len(each) > 80 and len(each.split()) > 1]
    assert [each for each in wide if not COMMAND.match(each) and each.strip() not in SCENE] == []
    return code, unfolded(text)


@pytest.mark.parametrize(("line", "code", "parts"), [(line, code, parts) for line, code, *parts in MISTAKES])
def test_a_mistake_is_answered_by_its_cause_and_a_way_out(folder, capsys, line, code, parts):
    found, text = answer(line, capsys)
    assert (found, [part for part in parts if part.format(here=folder) not in text]) == (code, []), text
    assert "Traceback" not in text


@pytest.mark.parametrize("line", NEED_MITSUBA)
def test_without_mitsuba_each_command_says_so_before_any_work(folder, monkeypatch, capsys, line):
    missing = variants.Variants(False, None, "scalar_rgb: exit code 1: No module named 'drjit'")
    monkeypatch.setattr(variants, "usable_variants", lambda: missing)
    code, text = answer(f"{JUDGE} {line}", capsys)
    assert code == 2 and "Mitsuba is not installed: pip install mitsuba==" in text
    assert "FAIL" not in text and "Traceback" not in text and len(text) < 250


def test_what_fails_alike_in_several_scenes_is_said_in_full_once(folder, capsys):
    Path("again.toml").write_text(SCENE)
    code, text = answer("mitsuba-ref validate scene.toml again.toml --candidate beginners:raises", capsys)
    assert code == 1 and text.count("beginners.py:4") == 1 and text.count("RuntimeError: no such shape") == 2
    assert text.count("no such shape: as in") == 1

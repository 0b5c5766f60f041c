"""The programs of docs/programs: short, shown on the API page, run, and a type checker finds a misspelt keyword."""

import ast
import os
import re

import pytest
from places import PYPROJECT
from programs import FOLDER, MAX_LINES, ROOT, python, run_program

PROGRAMS = {path.name: path for path in sorted(FOLDER.glob("*.py"))}
OURS = [
    name for name in PROGRAMS if name.startswith("caster_")
]  # those of the judge: tests/reference/test_judge_programs.py


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_program_is_short_and_on_the_api_page(name):
    comment, _, text = PROGRAMS[name].read_text().partition("\n")
    assert comment.startswith("# ") and len(text.splitlines()) <= MAX_LINES
    assert f"```python\n{text}```" in (ROOT / "docs/api.md").read_text()


SAYS = {
    "caster_aovs.py": r"Aovs\(depth, normal: 320 x 240 pixels, \d{4,} hit\)\nnearest \d+\.\d+, farthest \d+\.\d+ ",
    "caster_camera.py": r"(Scene\(\d+ x \d+ pixels, (pinhole|fisheye) camera, .*\) Aovs\(depth: .* \d{3,} hit\)\n){3}",
    "caster_mesh.py": r"Scene\(256 x 256 pixels, pinhole camera, 2 shapes, 0 lights\) Aovs\(.* \d{3,} hit\)",
    "caster_rays.py": r"Hits\(rays: 1000, hit: \d{3}\) .*\n\d+ of \d+ points have something above them",
}


@pytest.mark.parametrize("name", OURS)
def test_a_program_runs(name, tmp_path):
    (tmp_path / "scenes").symlink_to(ROOT / "scenes")
    assert re.match(SAYS[name], run_program(PROGRAMS[name], tmp_path))


# Names that are no keyword of a program.
OTHER = """import numpy as np
import caster
import mitsuba_ref

scene = caster.load_scene("scene.toml")
aovs = caster.rendr(scene)  # wrong
hits = caster.cast(scene, np.zeros(3), np.ones((1, 3)))
t = hits.tt  # wrong
depth = caster.render(scene, aovs=("depth",)).dept  # wrong
verdict = mitsuba_ref.validate(scene)
verdict.okay  # wrong
mitsuba_ref.valdate(scene)  # wrong
print(verdict.ok, hits.t.shape, caster.render(scene, aovs=("depth",)).depth)
"""
OURS_OR_JUDGES = ("caster.", "mitsuba_ref.", "scene.")
TAKES_ANY = ("with_camera", "from_trimesh")  # keywords of a camera or a shape, which are checked when the program runs


def misspelt(text):
    """The program with each keyword misspelt, and the lines of those."""
    calls = [(ast.unparse(node.func), node) for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    checked = [call for name, call in calls if name.startswith(OURS_OR_JUDGES) and not name.endswith(TAKES_ANY)]
    words, lines = [word for call in checked for word in call.keywords], text.splitlines()
    for word in sorted(words, key=lambda each: -each.col_offset):
        line = lines[word.lineno - 1]
        lines[word.lineno - 1] = line[: word.col_offset] + "x" + line[word.col_offset :]
    return "\n".join(lines) + "\n", {word.lineno for word in words}


@pytest.mark.slow("mypy reads both packages and what they import")
def test_a_type_checker_finds_what_a_user_misspells_and_nothing_else(tmp_path):
    """Of programs outside of the tree. Once installed, mypy reads a package only if it has a py.typed."""
    typed = PYPROJECT["tool"]["setuptools"]["package-data"]
    for package in ("caster", "mitsuba_ref"):
        assert (ROOT / package / "py.typed").exists() and "py.typed" in typed[package]
    expected = {"other.py": {i for i, line in enumerate(OTHER.splitlines(), 1) if "# wrong" in line}}
    (tmp_path / "other.py").write_text(OTHER)
    for name, path in PROGRAMS.items():
        text, expected[f"misspelt_{name}"] = misspelt(path.read_text())
        (tmp_path / f"misspelt_{name}").write_text(text)
        (tmp_path / name).write_text(path.read_text())
        expected[name] = set()
    # its trace is what the programs import from the reader's own mine.py
    path = os.pathsep.join([str(ROOT), str(ROOT / "mitsuba_ref/starters/python")])
    words = ("-m", "mypy", "--cache-dir", ROOT / ".mypy_cache", *expected)
    told = python(*words, cwd=tmp_path, MYPYPATH=path).stdout
    found = {name: set() for name in expected}
    for name, line in re.findall(r"^(\w+\.py):(\d+): error", told, re.MULTILINE):
        found[name].add(int(line))
    assert found == expected, told

"""The caster's programs of docs/programs work as written, and a type checker finds what a user misspells."""

import os
import re
import subprocess
import sys
import tomllib

import pytest
from programs import FOLDER, ROOT, check_length, check_types, run_program

PROGRAMS = sorted(FOLDER.glob("caster_*.py"))  # those of the judge: tests/reference/test_programs.py
SAYS = {
    "caster_aovs": r"Aovs\(depth, normal: 320 x 240 pixels, \d{4,} hit\)\nnearest \d+\.\d+, farthest \d+\.\d+ ",
    "caster_camera": r"(Scene\(\d+ x \d+ pixels, (pinhole|fisheye) camera, .*\) Aovs\(depth: .* \d{3,} hit\)\n){3}",
    "caster_mesh": r"Scene\(256 x 256 pixels, pinhole camera, 2 shapes, 0 lights\) Aovs\(.* \d{3,} hit\)",
    "caster_rays": r"Hits\(rays: 1000, hit: \d{3}\) .*\n\d+ of \d+ points have something above them",
}


@pytest.mark.usefixtures("warm")
@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.stem)
def test_a_program_works_as_written(path, tmp_path):
    (tmp_path / "scenes").symlink_to(ROOT / "scenes")
    check_length(path)
    assert re.match(SAYS[path.stem], run_program(path, tmp_path))


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


@pytest.mark.slow("mypy reads both packages and what they import")
def test_a_type_checker_finds_what_a_user_misspells_and_nothing_else(tmp_path):
    """Of programs outside of the tree. Once installed, mypy reads a package only if it has a py.typed."""
    typed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]
    for package in ("caster", "mitsuba_ref"):
        assert (ROOT / package / "py.typed").exists() and "py.typed" in typed[package]
    check_types(PROGRAMS, tmp_path)
    (tmp_path / "other.py").write_text(OTHER)
    command = [sys.executable, "-m", "mypy", "--cache-dir", str(ROOT / ".mypy_cache"), "other.py"]
    env = os.environ | {"MYPYPATH": str(ROOT)}
    told = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True).stdout
    wrong = {i for i, line in enumerate(OTHER.splitlines(), 1) if "# wrong" in line}
    assert {int(line) for line in re.findall(r"^other\.py:(\d+): error", told, re.MULTILINE)} == wrong, told

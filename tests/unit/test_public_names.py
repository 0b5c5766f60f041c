"""The public names of caster: complete, typed and loaded on first use."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import caster
from caster.cameras import CAMERAS
from caster.scene.model import LIGHTS
from caster.shapes import SHAPES

ROOT = Path(__file__).resolve().parents[2]
RECITED = {"load_scene", "Scene", "SceneError", "render", "cast", "occluded", "Hits", "read_exr", "write_exr"}
DESCRIPTIONS = {"Film", "Diffuse", "Shading", "Check"}
REGISTERED = {entry.__name__: entry for entry in (*SHAPES, *CAMERAS, *LIGHTS)}


def python(source: str) -> str:
    """What a fresh interpreter prints."""
    return subprocess.run([sys.executable, "-c", source], cwd=ROOT, capture_output=True, text=True, check=True).stdout


def test_all_names_what_there_is_and_nothing_else():
    assert set(caster.__all__) == RECITED | DESCRIPTIONS | REGISTERED.keys() | {"__version__"}
    assert set(caster.__all__) <= set(dir(caster))
    assert all(hasattr(caster, name) for name in caster.__all__)
    assert all(getattr(caster, name) is entry for name, entry in REGISTERED.items())


def test_importing_caster_loads_no_package_but_itself():
    loaded = python("import sys, caster; print(*{name.partition('.')[0] for name in sys.modules})").split()
    assert "caster" in loaded
    assert not {"numba", "llvmlite", "numpy", "pydantic", "OpenEXR"} & set(loaded)


def test_no_module_of_the_package_hides_a_public_name():
    """A module caster/render.py would take the place of the function caster.render once it is imported."""
    modules = {path.stem for path in (ROOT / "caster").iterdir() if path.suffix == ".py" or path.is_dir()}
    assert "rendering" in modules
    assert not modules & set(caster.__all__)


PROGRAM = """import numpy as np
import caster
import mitsuba_ref

scene = caster.load_scene("scene.toml")
film = caster.Film(widht=3)  # wrong
aovs = caster.rendr(scene)  # wrong
hits = caster.cast(scene, np.zeros((1, 3)), np.ones((1, 3)), tmin=0.0)  # wrong
t = hits.tt  # wrong
verdict = mitsuba_ref.validate(scene)
verdict.okay  # wrong
mitsuba_ref.valdate(scene)  # wrong
print(verdict.ok, hits.t.shape, caster.render(scene, aovs=("depth",)).hit)
"""


@pytest.mark.slow("mypy reads both packages and what they import")
def test_a_type_checker_finds_what_a_user_misspells_and_nothing_else(tmp_path):
    """Of a program outside of the tree. Once installed, mypy reads a package only if it has a py.typed."""
    typed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]
    for package in ("caster", "mitsuba_ref"):
        assert (ROOT / package / "py.typed").exists() and "py.typed" in typed[package]
    (tmp_path / "program.py").write_text(PROGRAM)
    command = [sys.executable, "-m", "mypy", "--cache-dir", str(ROOT / ".mypy_cache"), "program.py"]
    env = os.environ | {"MYPYPATH": str(ROOT)}
    told = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True).stdout
    wrong = {i for i, line in enumerate(PROGRAM.splitlines(), 1) if "# wrong" in line}
    assert {int(line) for line in re.findall(r"^program\.py:(\d+): error", told, re.MULTILINE)} == wrong, told

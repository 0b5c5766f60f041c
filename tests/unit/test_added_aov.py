"""An AOV added as documented, by one file and its entry in the registry, is computed or refused, never left unset."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ADDED = '''"""Twice the ray parameter."""

NAME, CHANNELS, MISS = "twice", ("twice.T",), 0.0


def evaluate(view):
    return 2.0 * view.nearest.t
'''
SCENE = """
camera = { type = "pinhole", eye = [0, 0, 5], look_at = [0, 0, 0] }
film = { width = 4, height = 3 }
[[shape]]
type = "sphere"
"""


@pytest.fixture
def folder(tmp_path):
    """A copy of the renderer with one more AOV, and a scene."""
    shutil.copytree(ROOT / "caster", tmp_path / "caster", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "caster/aovs/twice.py").write_text(ADDED)
    registry = tmp_path / "caster/aovs/__init__.py"
    before = registry.read_text()
    after = before.replace("from caster.aovs import ", "from caster.aovs import twice, ")
    after = after.replace("AOVS: tuple[ModuleType, ...] = (", "AOVS: tuple[ModuleType, ...] = (twice, ")
    assert after.count("twice, ") == 2
    registry.write_text(after)
    (tmp_path / "s.toml").write_text(SCENE)
    return tmp_path


@pytest.mark.parametrize("camera", ["pinhole", "panorama"])  # rasterised, and through the tree
def test_an_added_aov_that_the_film_does_not_compute_is_refused(folder, camera):
    scene = folder / "s.toml"
    scene.write_text(scene.read_text().replace("pinhole", camera))
    env = {**os.environ, "PYTHONPATH": str(folder), "CASTER_JIT": "0"}
    command = [sys.executable, "-m", "caster", "render", "s.toml", "--aov", "depth,twice"]
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True)
    assert done.returncode == 2, done.stdout
    assert done.stderr.startswith("s.toml: aov 'twice': render does not compute it for a film"), done.stderr
    assert not (folder / "s.exr").exists()

"""A primitive kind and a camera of a plug-in work in every command, and faults in them are found.

The coin's two sides are tests/unit/coin_plugin.py and coin_reference.py; docs/internals/adding-a-shape.md describes
them.
"""

import shutil
from pathlib import Path

import pytest
from coin_scenes import COINS, LAMP, PINHOLE
from edited_tree import ROOT, edit, ended_well, run_with
from outputs import json_of
from programs import install

SCENE = "[film]\nwidth = 12\nheight = 9\n" + PINHOLE + LAMP + COINS


@pytest.fixture
def coins(tmp_path) -> Path:
    """A folder with an installed distribution: the kind on both sides, and a scene."""
    shutil.copy(ROOT / "tests/unit/coin_plugin.py", tmp_path)
    shutil.copy(ROOT / "tests/reference/coin_reference.py", tmp_path)
    (tmp_path / "coins.toml").write_text(SCENE)
    install(tmp_path, "coins", caster="coin_plugin", mitsuba_ref="coin_reference")
    return tmp_path


def test_a_foreign_kind_is_judged_reported_and_probed(coins):
    files = ("--html", str(coins / "report"), "--json", str(coins / "verdict.json"))
    found = ended_well(run_with(coins, "validate", str(coins / "coins.toml"), *files))
    assert "PASS  coins" in found.stdout and (coins / "report/index.html").stat().st_size > 10_000
    (scene,) = json_of(coins / "verdict.json")["scenes"]
    assert scene["biases"][0]["kind"] == "Coins"
    probed = ended_well(run_with(coins, "probe", str(coins / "coins.toml"), "6", "4"))
    assert "coins.toml: agree" in probed.stdout and "shape-1" in probed.stdout


@pytest.mark.slow("fuzz in plain Python")
def test_a_foreign_kind_is_fuzzed(coins):
    """`planes` draws all registered kinds of the group "flat"."""
    words = ("fuzz", "--examples", "12", "--family", "planes", "--judge-every", "0", "--out", str(coins / "found"))
    assert "nothing found" in ended_well(run_with(coins, *words)).stdout


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("rounded(np.array([self.radius]))", "rounded(np.array([1.001 * self.radius]))", "geometry: "),
        ("return point_at(o, t, d), n, n", "return point_at(o, 1.001 * t, d), n, n", "position: "),
        ("turn_fraction(y, x) if", "turn_fraction(-y, x) if", "uv: "),
        ("n = (0.0, 0.0, 1.0)", "n = (0.0, 0.6, 0.8)", "normal: "),
    ],
)
@pytest.mark.slow("each judges in plain Python")
def test_a_mistake_in_a_foreign_kind_is_found(coins, old, new, says):
    edit(coins, "coin_plugin.py", old, new)
    found = run_with(coins, "validate", str(coins / "coins.toml"))
    assert found.returncode == 1 and "FAIL  coins" in found.stdout and says in found.stdout


@pytest.mark.slow("judges twice in plain Python")
def test_a_foreign_camera_is_judged_and_a_mistake_in_it_is_found(coins):
    scanned = SCENE.replace('"pinhole"', '"scanner"\nspacing = 0.34')
    (coins / "scanned.toml").write_text(scanned)
    words = ("validate", str(coins / "scanned.toml"))
    assert "PASS  scanned" in ended_well(run_with(coins, *words)).stdout
    edit(coins, "coin_plugin.py", "camera.center[1] - y", "camera.center[1] - 1.001 * y")
    found = run_with(coins, *words)
    assert found.returncode == 1 and "FAIL  scanned" in found.stdout and "camera: " in found.stdout

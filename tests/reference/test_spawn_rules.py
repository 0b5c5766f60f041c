"""Origins of rays by Mitsuba, by ours and by a candidate: mitsuba3 issue 1871, and the commands that judge it."""

from pathlib import Path

import numpy as np
import pytest
from outputs import json_of, unfolded

from mitsuba_ref.__main__ import main

pytestmark = pytest.mark.usefixtures("remembered")

NESTED = """[film]
width = 8
height = 8
[camera]
type = "pinhole"
eye = [0, 0, 4]
look_at = [0, 0, 0]
fov = 40
[material.glass]
type = "glass"
[[shape]]
type = "sphere"
material = "glass"
[[shape]]
type = "sphere"
radius = 0.99996
"""
CANDIDATE = """
def far(points, normals, directions):
    return points + 1e-3 * directions

def flat(points, normals, directions):
    return points[0]
"""


@pytest.fixture
def judged(here, capsys):
    """Writes the scene, its rays and a candidate; calls `judge --spawned` with more options: (exit code, stdout)."""
    (here / "nested.toml").write_text(NESTED)
    (here / "origins_of_mine.py").write_text(CANDIDATE)
    assert main(["rays", "nested.toml", "--bounces", "1", "-o", "rays"]) == 0

    def judge(*more, spawned="rays/bounce-1.npz"):
        capsys.readouterr()
        files = ["--scene", "nested.toml", "--rays", "rays/bounce-0.npz", "--spawned", spawned]
        code = main(["judge", *files, *more])
        return code, "".join(capsys.readouterr())

    return judge


def test_rays_that_start_too_far_skip_the_inner_of_two_spheres_as_spawn_ray_does_and_ours_do_not(judged, tmp_path):
    assert judged()[0] == 0
    rays = dict(np.load("rays/bounce-1.npz"))
    rays["rays"][:, :3] += 1e-3 * rays["rays"][:, 3:6]
    np.savez("far.npz", rays=rays["rays"], parent=rays["parent"])
    code, text = judged("--out", "out", "--json", "found.json", spawned="far.npz")
    found = json_of(tmp_path / "found.json")
    assert code == 1 and "skipped surface (shape-1, prim 0)" in text
    assert found["skipped surface"] == found["rays"] / 2 == len(found["wrong"])
    assert max(map(len, text.splitlines())) <= 80

    # the reproducer: one ray, the parent, which shows the same again
    (file,) = Path("out").glob("nested.spawned-origin.*.toml")
    assert main(["validate", str(file), "--bounces", "1", "--out", "again", "-j", "1"]) == 0
    checks = {c["name"]: c for c in json_of("again/verdict.json")["scenes"][1]["checks"]}
    assert "1 skipped surface" in checks["reference_origins"]["what"]
    assert "no error" in checks["spawned_origins"]["what"]
    (again,) = Path("again").glob("*.spawn-ray.0.toml")
    assert again.read_text().split("\n\n", 1)[1] == file.read_text().split("\n\n", 1)[1]


def test_files_of_spawned_rays_that_cannot_be_judged(judged):
    rays = dict(np.load("rays/bounce-1.npz"))
    np.savez("no-parent.npz", rays=rays["rays"])
    np.savez("beyond.npz", rays=rays["rays"], parent=rays["parent"] + 10**6)
    np.savez("short.npz", rays=rays["rays"], parent=rays["parent"][1:])
    np.savez("miss.npz", rays=rays["rays"][:1], parent=[0])
    assert judged("--html", "out")[0] == 2
    for name, code, words in (
        ("no-parent", 4, "expected arrays of rays, parent, got rays"),
        ("beyond", 2, "parent[0]: expected a ray of"),
        ("short", 2, "whole numbers"),
        ("miss", 5, "nothing judged"),
    ):
        found, text = judged(spawned=f"{name}.npz")
        assert found == code and words in unfolded(text)


def test_a_sweep_counts_the_errors_of_every_rule(judged, tmp_path, capsys):
    assert main(["stress", "spawn-gap", "--rays", "8", "--json", "sweep.json"]) == 0
    (sweep,) = json_of(tmp_path / "sweep.json")["families"]
    rules = {setting["x"]: setting["rules"] for setting in sweep["settings"]}
    skipped = [rules[4e-5][name]["counts"]["skipped surface"] for name in ("mitsuba", "constant")]
    assert skipped == [rules[4e-5]["ours"]["counts"]["rays"] / 2] * 2
    assert rules[4e-5]["ours"]["wrong"] == rules[0.1]["mitsuba"]["wrong"] == 0
    assert main(["stress", "spawn-gap", "--rays", "4", "--spawn", "origins_of_mine:far", "--out", "kept"]) == 1
    assert "candidate: 4 skipped surface" in unfolded(capsys.readouterr().out) and list(Path("kept").iterdir())
    for name, code, words in (("flat", 1, "expected origins of shape"), ("none", 2, "origins_of_mine has no 'none'")):
        assert main(["stress", "spawn-gap", "--rays", "4", "--spawn", f"origins_of_mine:{name}"]) == code
        assert words in unfolded("".join(capsys.readouterr()))

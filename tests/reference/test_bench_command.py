"""`mitsuba-ref bench` from end to end: ours and Mitsuba's scalar variant, a small picture, one alternation."""

import json

import pytest

from mitsuba_ref.__main__ import main
from mitsuba_ref.bench import run
from mitsuba_ref.bench.contestants import BY_KEY
from mitsuba_ref.bench.measuring import Settings, time_scene
from mitsuba_ref.bench.scenes import SCENES
from mitsuba_ref.reference.variants import usable_variants

ASKED = ("ours", "scalar-aov", "scalar-loop")
SIDE = 64


def test_a_small_image_is_timed_and_judged(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(run, "contestants_for", lambda asks, peers: [BY_KEY[key] for key in ASKED])
    file = tmp_path / "run.json"
    words = ["bench", "cornell-box", "--size", str(SIDE), "--alternations", "1", "--json", str(file)]
    assert main(words) == 0
    data = json.loads(file.read_text())
    (scene,) = data["scenes"]
    assert scene["primitives"] == 30 and data["settings"]["alternations"] == 1
    rows = {row["key"]: row for row in scene["rows"]}
    assert set(rows) == set(ASKED)
    for key, row in rows.items():
        assert row["why"] == "", key
        assert len(row["seconds"]) == 1 and row["rays"] == row["size"] ** 2 and row["size"] <= SIDE
        assert row["ns"] > 0.0 and row["ratio"] > 0.0 and row["build"] > 0.0
        assert 2**24 < row["memory"] < 2**36
        assert row["score"]["masks"] == row["score"]["beyond"] == 0
    ours, scalar = rows["ours"]["score"], rows["scalar-aov"]["score"]
    assert ours["edge_masks"] == ours["edge_beyond"] == 0 and ours["ulps"] < 1e-6
    assert 1e-2 < scalar["ulps"] < 100.0 and scalar["bounds"] < 1.0
    assert rows["scalar-loop"]["score"] == scalar  # the same intersector
    out = capsys.readouterr().out
    assert (
        "Mitsuba scalar, robust, AOV integrator" in out and "1 of 1 scenes, 3 rows, 0 without numbers" in out
    )


@pytest.mark.parametrize(
    "name, keys", [("cornell-box", ("raw-robust", "aov-robust")), ("rays-shadow", ("raw-robust-incoherent",))]
)
def test_mitsubas_llvm_variant_is_requested_what_is_timed(name, keys):
    """A flag in the place of another one would be fast, and wrong about most rays."""
    (scene,) = (scene for scene in SCENES if scene.name == name)
    found = time_scene(scene, [BY_KEY[key] for key in keys], Settings(16, 1))
    for row in found.rows:
        if not usable_variants().llvm:
            assert row.why.startswith("llvm_ad_rgb does not work here"), row
            continue
        assert row.why == "" and row.rays == 256 and row.score.masks == row.score.beyond == 0, row
        assert row.score.edge_masks < row.score.edge_rays // 10

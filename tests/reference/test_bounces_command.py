"""--bounces of validate, rays and probe on the shipped scene of glass and mirrors."""

import json

import numpy as np
import pytest
from outputs import json_of
from places import SCENES

import caster
from mitsuba_ref.__main__ import main

pytestmark = pytest.mark.usefixtures("remembered")
SCENE = str(SCENES / "glass-and-mirror.toml")
SIZE = ("--size", "16", "12")


def test_six_bounces_pass_with_counts_of_every_kind_and_a_page_each(tmp_path, capsys):
    out = tmp_path / "verdict.json"
    assert main(["validate", SCENE, *SIZE, "--bounces", "6", "-j", "1", "--json", str(out)]) == 0
    scenes = json_of(out)["scenes"]
    assert [scene["bounce"] for scene in scenes] == [*range(7)]
    text = capsys.readouterr().out
    for scene in scenes[1:]:
        counts = [sum(classes.values()) for classes in scene["kinds"].values()]
        assert list(scene["kinds"]) == ["reflected", "refracted", "shadow"] and min(counts) > 0
        assert f"{counts[0]} reflected" in text and not {"wrong", "undecided"} & set(scene["kinds"]["reflected"])
        assert "secondary_rays" in {check["name"] for check in scene["checks"]}


def test_rays_are_written_bounce_by_bounce_with_their_parents(tmp_path):
    assert main(["rays", SCENE, *SIZE, "--bounces", "2", "-o", str(tmp_path)]) == 0
    first, second, third = (np.load(tmp_path / f"bounce-{number}.npz") for number in range(3))
    hits = caster.cast(caster.load_scene(SCENE), first["rays"][:, :3], first["rays"][:, 3:6])
    np.testing.assert_allclose(second["rays"][:, :3], hits.position[second["parent"]], atol=1e-5)
    assert (second["pixels"] == first["pixels"][second["parent"]]).all()
    assert (third["pixels"] == second["pixels"][third["parent"]]).all()
    assert set(second["kind"][third["parent"]]) <= {1, 2}


def test_probe_follows_the_path_of_a_pixel(capsys):
    assert main(["probe", SCENE, "5", "7", *SIZE, "--bounces", "2", "--json"]) == 0
    path = json.loads(capsys.readouterr().out)["path"]
    names = [each["path"] for each in path]
    assert len(names) > 2 and all(name[:-1] in ("", *names) for name in names)
    assert {each["verdict"] for each in path} <= {"agree", "explained"}


@pytest.mark.parametrize("faulty", [False, True])
def test_a_candidate_is_judged_along_secondary_rays(faulty, here, monkeypatch, capsys):
    """One that misses what is near passes along the camera's rays."""
    (here / "bounced.py").write_text(
        "import caster, numpy as np\n"
        "def trace(scene, o, d):\n"
        f"    hits = caster.cast(scene, o, d, t_min={0.3 if faulty else 0.0})\n"
        "    return hits.t, hits.normal\n"
    )
    monkeypatch.syspath_prepend(here)
    monkeypatch.delitem(__import__("sys").modules, "bounced", raising=False)
    words = ["validate", SCENE, *SIZE, "--bounces", "1", "--candidate", "bounced:trace", "-j", "1"]
    assert main(words) == faulty
    text = capsys.readouterr().out
    assert "PASS  glass-and-mirror  " in text
    assert ("FAIL  glass-and-mirror.bounce-1" in text) == faulty
    assert ("--candidate bounced:trace --size 16 12 --bounces 1" in text) == faulty


def test_images_have_no_secondary_rays(capsys):
    assert main(["validate", SCENE, "--bounces", "1", "--candidate", "true {xml} {exr}"]) == 2
    assert "--bounces: expected a candidate that takes rays" in capsys.readouterr().err

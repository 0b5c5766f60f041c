"""`mitsuba-ref bench` from end to end: ours and Mitsuba's scalar variant, a small image, one alternation."""

import json
from dataclasses import replace

import pytest
from outputs import json_of
from programs import printed_by

from mitsuba_ref.__main__ import main
from mitsuba_ref.bench import casters, scenes
from mitsuba_ref.bench.casters import BY_KEY
from mitsuba_ref.bench.measuring import time_scene, write_scene
from mitsuba_ref.reference.variants import LLVM, environment_for, usable_variants

SCENES = {scene.name: scene for scene in scenes.SCENES}
ASKED = ("ours", "scalar-aov")
SIDE = 32


def only(monkeypatch, *keys):
    monkeypatch.setattr(casters, "CASTERS", [BY_KEY[key] for key in keys])


def test_a_small_image_is_timed_and_judged(tmp_path, monkeypatch, capsys):
    only(monkeypatch, *ASKED)
    file = tmp_path / "run.json"
    words = ["bench", "grazing-plane", "--size", str(SIDE), "--alternations", "1", "--json", str(file)]
    assert main(words) == 0
    data = json_of(file)
    (scene,) = data["scenes"]
    assert scene["primitives"] == 2 and data["settings"]["alternations"] == 1
    rows = {row["key"]: row for row in scene["rows"]}
    assert set(rows) == set(ASKED)
    for key, row in rows.items():
        assert row["why"] == "", key
        assert len(row["seconds"]) == 1 and row["rays"] == row["size"] ** 2 and row["size"] <= SIDE
        assert row["ns"] > 0.0 and row["ratio"] > 0.0 and row["build"] > 0.0
        assert row["score"]["masks"] == row["score"]["beyond"] == 0
    ours, scalar = rows["ours"]["score"], rows["scalar-aov"]["score"]
    assert ours["ulps"] < 1e-6
    assert 1e-2 < scalar["ulps"] < 100.0 and scalar["bounds"] < 1.0
    out = capsys.readouterr().out
    assert "Mitsuba scalar, robust, AOV integrator" in out and "1 of 1 scenes, 2 rows, 0 without numbers" in out


@pytest.mark.parametrize(
    "name, keys", [("overdraw-256", ("raw-robust", "aov-robust")), ("rays-incoherent", ("raw-robust",))]
)
def test_mitsubas_llvm_variant_is_requested_what_is_timed(name, keys):
    """A caster with a wrong flag could be fast and wrong for most rays."""
    found = time_scene(SCENES[name], [BY_KEY[key] for key in keys], 16, 1)
    for row in found.rows:
        if not usable_variants().libllvm:
            assert row.why.startswith("llvm_ad_rgb does not work here"), row
            continue
        assert row.why == "" and row.rays == 256 and row.score.masks == row.score.beyond == 0, row


def test_a_file_and_a_candidate_are_timed_and_judged_beside_ours(here, monkeypatch, capsys):
    only(monkeypatch, "ours")
    (here / "box.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n")
    (here / "timed_caster.py").write_text(
        "import caster\nscenes = []\n\n\ndef cast(scene, o, d):\n    if all(scene is not each for each in scenes):\n"
        "        scenes.append(scene)\n    assert len(scenes) <= 4, 'each build of the caster is one scene'\n"
        "    hits = caster.cast(scene, o, d, t_min=1e-30)\n    return hits.t, hits.normal\n"
    )
    words = ["bench", "box.obj", "--size", "32", "--alternations", "2", "--json", "run.json", "--candidate"]
    assert main([*words, "timed_caster:cast"]) == 0
    data = json_of(here / "run.json")
    (scene,) = data["scenes"]
    assert (scene["name"], scene["title"], scene["primitives"]) == ("box", "box.obj", 4)
    assert data["settings"]["candidate"] == "timed_caster:cast"
    ours, candidate = scene["rows"]
    assert (candidate["key"], candidate["title"], candidate["why"]) == ("candidate", "timed_caster:cast", "")
    assert candidate["rays"] == 32**2 == ours["rays"] and candidate["ratio"] > 0.0
    assert candidate["score"]["masks"] == ours["score"]["masks"] == 0
    assert "timed_caster:cast" in capsys.readouterr().out


@pytest.mark.slow("times several processes")
def test_a_candidate_that_cannot_be_timed_is_no_result(here, monkeypatch, capsys):
    only(monkeypatch, "ours")
    (here / "untimed_caster.py").write_text("def cast(scene, o, d):\n    raise NotImplementedError('spheres')\n")
    words = ["bench", "one-sphere", "--size", "8", "--alternations", "1", "--candidate"]
    assert main([*words, "untimed_caster:cast"]) == 1
    assert "untimed_caster:cast raised NotImplementedError: spheres" in capsys.readouterr().out
    assert main([*words, "true {xml} -o {exr}"]) == 2
    assert main(["bench", "nothing.obj"]) == 4


VALUES = """
import json, sys
import numpy as np
from mitsuba_ref.bench.drivers import Ours, Work
from mitsuba_ref.bench.mitsuba_drivers import Integrator, mi

aovs = ("depth", "normal", "shading_normal", "diffuse")
work = Work(sys.argv[1], "film", "", aovs, {"mode": "robust", "variant": "llvm_ad_rgb"})
ours, aov = Ours(work), Integrator(work)
for each in (ours, aov):
    each.build(64)
images = ours.caster.render(ours.scene, aovs)
hit = images.hit.ravel()
drawn = np.array(mi.render(aov.scene, integrator=aov.integrator, spp=1), float).reshape(64 * 64, -1)[hit]
found = {"hit": float(hit.mean()), "lit": float((images["diffuse"] > 0.1).mean())}
columns = {"depth": slice(4, 5), "normal": slice(5, 8), "shading_normal": slice(8, 11), "diffuse": slice(0, 3)}
for name, column in columns.items():
    off = np.abs(drawn[:, column] - np.asarray(images[name]).reshape(64 * 64, -1)[hit]).max(axis=1) > 1e-3
    found[name] = float(off.mean())
print(json.dumps(found))
"""


def test_mitsuba_is_timed_with_the_image_that_ours_is(tmp_path):
    """A caster without cosine or shadow rays would be fast and give another image. Pixels on edges may differ."""
    if not usable_variants().libllvm:
        return  # the rows are empty then, which the test above has
    made = SCENES["kinds-lit"].make()
    lamp_alone = made.model_copy(update={"lights": made.lights[:1]})
    write_scene(replace(SCENES["kinds-lit"], make=lambda: lamp_alone), tmp_path, 64)
    found = json.loads(printed_by("-c", VALUES, tmp_path, **environment_for(LLVM)))
    assert found.pop("hit") > 0.5 and 0.2 < found.pop("lit") < 0.9
    assert len(found) == 4 and max(found.values()) < 0.02, found

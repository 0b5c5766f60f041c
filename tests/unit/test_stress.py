"""The sweeps exercise what they say, find every planted fault and report all of it. Without Mitsuba."""

import json
import os
import re
import shlex
import signal
import sys
import time
import xml.etree.ElementTree as ElementTree
from collections import Counter
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import stress_page
from outputs import json_of, unfolded
from pages import read_result

import caster
from mitsuba_ref.__main__ import main
from mitsuba_ref.cli.doctor import result_schema
from mitsuba_ref.cli.options import select
from mitsuba_ref.hard import BY_NAME
from mitsuba_ref.hard.swept_families import SWEPT
from mitsuba_ref.judge.verdict import as_json
from mitsuba_ref.reference.variants import Variants
from mitsuba_ref.report import output
from mitsuba_ref.report.output import write_result
from mitsuba_ref.stress import sweeps
from mitsuba_ref.stress.sweeps import Absent, Scorer, StressRun, SweepResult
from mitsuba_ref.subjects.function import FunctionSubject
from mitsuba_ref.subjects.subject import Answer

RAYS = 25
NAMES = [family.name for family in SWEPT]
REFERENCES = ("scalar", "llvm", "llvm-robust")


@pytest.fixture(autouse=True)
def no_mitsuba(monkeypatch, here):
    """An empty folder, and a machine where no variant works: sweeps go on with ours and exact arithmetic."""
    nothing = Variants(False, None, "planted: nothing works")
    monkeypatch.setattr(sweeps, "usable_variants", lambda: nothing)
    monkeypatch.setattr(output, "usable_variants", lambda: nothing)


def short(name: str, *places: int):
    """A family with some of its values."""
    family = BY_NAME[name]
    return replace(family, values=tuple(family.values[i] for i in places) or family.values)


def run(name: str, *places: int, **more: object) -> SweepResult:
    return sweeps.sweep(short(name, *places), 0, RAYS, **more)


@pytest.fixture
def only(monkeypatch):
    """Let some families be the only ones."""
    return lambda *families: monkeypatch.setattr("mitsuba_ref.cli.experiments.SWEPT", families)


@pytest.mark.parametrize("name", NAMES)
def test_ours_is_exact_in_every_setting_and_every_setting_shows_something(name):
    family, sweep = BY_NAME[name], run(name)
    positive = [x for x in family.values if x > 0.0]
    assert list(family.values) == sorted(set(family.values)) and len(family.values) >= 6
    assert positive[-1] / positive[0] >= 1e3 and family.values[0] <= family.easiest <= family.values[-1]
    assert sweep.ok, sweep.problems
    assert len(sweep.settings) == len(family.values)
    for outcome in sweep.settings:
        ours = outcome.witnesses["ours"]
        assert outcome.rays == outcome.adjudicated == RAYS
        assert ours.compared == outcome.hits >= outcome.rays // 8
        assert outcome.rays - outcome.hits >= (0 if family.closed else outcome.rays // 10)
        assert outcome.bound64 > 0.0 and ours.worst <= 1.0
        assert all(outcome.witnesses[key] == Absent("missing", "planted: nothing works") for key in REFERENCES)


def test_settings_depend_on_the_seed_alone():
    for family in SWEPT:
        first, again, other = (sweeps.prepare_setting(family, seed, family.values[-1], RAYS) for seed in (0, 0, 1))
        assert np.array_equal(first.o, again.o) and np.array_equal(first.d, again.d)
        assert not np.array_equal(first.d, other.d)


def test_a_mesh_that_is_not_closed_is_refused():
    ready = sweeps.prepare_setting(replace(BY_NAME["tangency"], closed=True), 0, 0.1, RAYS)
    with pytest.raises(AssertionError, match="leaves a closed mesh"):
        Scorer(ready, np.zeros(RAYS, bool))


# --- planted faults


def without_a_primitive(found: Answer) -> Answer:
    gone = found.prim == Counter(found.prim[found.hit].tolist()).most_common(1)[0][0]
    return replace(found, t=np.where(gone, np.inf, found.t), prim=np.where(gone, -1, found.prim))


@pytest.mark.parametrize(("factor", "wrong"), [(1.0, 0), (1.0 + 1e-6, 1)])
def test_a_fault_of_ours_fails_the_run(factor, wrong, monkeypatch, capsys, only):
    honest = sweeps.cast_by_bvh
    monkeypatch.setattr(sweeps, "cast_by_bvh", lambda ready: replace(found := honest(ready), t=found.t * factor))
    only(short("scale-mesh", -1))
    assert main(["stress", "scale-mesh", "--rays", str(RAYS)]) == wrong
    shown = capsys.readouterr().out
    assert shown.startswith(f"{'FAIL' if wrong else 'PASS'}  scale-mesh") and f"1 of 1 families, {wrong} fail" in shown


def test_rays_that_show_nothing_fail_the_sweep():
    """A handful that all hit says nothing of misses."""
    sweep = run("tangency", 3)
    (setting,) = sweep.settings
    vacuous = replace(sweep, settings=(replace(setting, hits=RAYS),))
    assert sweep.ok and not vacuous.ok and "exact arithmetic has no misses" in vacuous.problems[0]


# --- scores


@pytest.fixture(scope="module")
def ball() -> tuple[Scorer, Answer]:
    """One sphere on another: every hit is a tie."""
    family, ball = BY_NAME["offset-sphere"], {"type": "sphere", "center": [0.5, 0.2, 0.1], "radius": 1.0}
    made = family.make(np.random.default_rng(1), 1.0)
    twice = made._replace(data=made.data | {"shape": [ball, ball]})
    ready = sweeps.prepare_setting(replace(family, make=lambda rng, x: twice), 3, 1.0, RAYS)
    return Scorer(ready, np.zeros(RAYS, bool)), sweeps.cast_by_bvh(ready)


def test_each_kind_of_mistake_is_counted_as_what_it_is(ball):
    scorer, found = ball
    hits = int(found.hit.sum())
    assert not scorer.score(found).breaks
    misnamed = replace(found, prim=np.where(found.hit, found.prim + 1, -1))
    assert scorer.score(misnamed).beyond == hits > 0  # ours names the first of a tie
    lost = scorer.score(replace(found, t=np.full(RAYS, np.inf), prim=np.full(RAYS, -1)))
    assert (lost.false_misses, lost.compared, lost.error, lost.breaks) == (hits, 0, None, True)
    always = replace(found, t=np.where(found.hit, found.t, 1.0), prim=np.where(found.hit, found.prim, 0))
    assert scorer.score(always).false_hits == RAYS - hits > 0
    broken = scorer.score(replace(found, t=np.where(found.hit, np.nan, found.t)))
    assert (broken.beyond, broken.wrong_masks) == (hits, 0)


def test_float32_may_be_as_far_off_as_its_bound_and_ours_may_not(ball):
    scorer, found = ball
    rounded = replace(found, t=found.t.astype(np.float32).astype(np.float64))
    theirs = scorer.score(Answer(rounded.t, None, "float32", {}), reference=True)
    ours = scorer.score(rounded)
    assert not theirs.breaks and 0.0 < theirs.worst < 1.0 and ours.beyond > 0 and ours.worst > 1.0
    assert theirs.error == ours.error and 1e-9 < theirs.error < 2.0**-24


# --- results


def test_the_first_breakdown_is_looked_for_on_both_sides_of_the_easiest_setting():
    sweep, x = run("scale-sphere"), BY_NAME["scale-sphere"].values
    wrong = {0: 1, 2: 1, 15: 1, 16: 1}
    settings = tuple(
        replace(each, witnesses=each.witnesses | {"ours": replace(each.witnesses["ours"], false_hits=wrong.get(i, 0))})
        for i, each in enumerate(sweep.settings)
    )
    broken = replace(sweep, settings=settings)
    assert sweep.breakdowns["ours"] == [] and broken.breakdowns["ours"] == [x[2], x[15]]
    assert "ours 1e-20 and 1e+18" in sweeps.as_text(broken) and not broken.ok


def test_leaks_and_what_is_missing_are_in_the_table(monkeypatch):
    honest = sweeps.cast_by_bvh
    monkeypatch.setattr(sweeps, "cast_by_bvh", lambda ready: without_a_primitive(honest(ready)))
    sweep = run("watertight-vertices", 0, 1)
    lost = sum(outcome.witnesses["ours"].false_misses for outcome in sweep.settings)
    text = sweeps.as_text(sweep)
    assert lost > 0 and f"leaks of {2 * RAYS} rays: ours {lost}, scalar missing" in text
    assert "planted" not in text, "the run says once why"


def test_json_has_the_same_numbers_again_and_brings_the_run_back(tmp_path, capsys, only):
    only(short("sliver", 0, 1), short("axis", -1))
    file = tmp_path / "run.json"
    texts = []
    for target in ("-", str(file)):
        assert main(["stress", "--json", target, "--rays", str(RAYS)]) == 0
        texts.append(json.loads(capsys.readouterr().out if target == "-" else file.read_text()))
        for family in texts[-1]["families"]:
            family.pop("seconds")
    assert texts[0] == texts[1]
    jsonschema.validate(json_of(file), result_schema("stress"))
    found = read_result(StressRun, str(file), "mitsuba-ref stress")
    write_result(found, str(tmp_path / "again.json"))
    assert json_of(tmp_path / "again.json") == json_of(file) == as_json(found)


def test_the_page_is_made_from_the_json_of_a_run(tmp_path, monkeypatch, only):
    only(short("tangency", -2, -1))
    file = tmp_path / "run.json"
    assert main(["stress", "--json", str(file), "--rays", str(RAYS)]) == 0
    monkeypatch.setattr(sys, "argv", ["stress_page.py", str(file), str(tmp_path)])
    stress_page.main()
    page = unfolded((tmp_path / "stress.md").read_text())
    assert "In 1 sweeps, 2 settings and 50 rays, 50 of them decided by exact arithmetic" in page
    assert "(stress/tangency.svg)" in page
    words = " ".join(ElementTree.parse(tmp_path / "stress/tangency.svg").getroot().itertext())
    for word in ("distance from the silhouette over radius", "ours", "predicted bound of float32", "missing"):
        assert word in words


# --- the command


def test_a_part_of_the_name_selects_all_that_begin_with_it(capsys):
    assert [family.name for family in select(SWEPT, "family", ["watertight"])] == NAMES[10:12]
    assert main(["stress", "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines if not line.startswith(" ")][: len(NAMES)] == NAMES


def test_a_candidate_of_images_is_refused(capsys):
    assert main(["stress", "--candidate", "true {xml} -o {exr}"]) == 2
    assert "expected one that casts rays it is given" in capsys.readouterr().err


def test_ctrl_c_keeps_what_is_done(tmp_path, monkeypatch, capsys):
    honest = sweeps.sweep

    def interrupted(family, *rest):
        if family.name == "offset-sphere":  # in a worker, while the first family is printed
            time.sleep(1.0)
            os.kill(os.getppid(), signal.SIGINT)
            time.sleep(60.0)
        return honest(family, *rest)

    monkeypatch.setattr(sweeps, "sweep", interrupted)
    out = tmp_path / "out.json"
    assert main(["stress", "offset", "-j", "1", "--rays", str(RAYS), "--json", str(out)]) == 130
    kept = json_of(out)
    assert [family["name"] for family in kept["families"]] == ["offset-mesh"]
    assert kept["requested"] == ["offset-mesh", "offset-sphere"] and not kept["ok"]
    assert "1 of 2 families" in capsys.readouterr().out


# ---- a candidate in place of ours


def altered(change):
    """The right caster, its (t, normal) changed by a function of the rays as well."""

    def cast(scene, o, d):
        found = caster.cast(scene, o, d)
        return change(o, d, found.t, found.normal)

    return cast


def only_if(keep):
    """A caster that misses where keep(o, d, t, n) does not hold."""
    return altered(lambda o, d, t, n: (np.where(keep(o, d, t, n), t, np.inf), n))


PLANTED = [
    ("watertight-edges", only_if(lambda o, d, t, n: np.arange(len(t)) % 7 != 0), "4 false misses"),
    ("grazing-rectangle", only_if(lambda o, d, t, n: np.abs((d * n).sum(axis=1)) > 1e-6), "false misses"),
    ("length-mesh", only_if(lambda o, d, t, n: np.linalg.norm(d, axis=1) > 1e-8), "false misses"),
    ("tangency", altered(lambda o, d, t, n: (t * (1 + 1e-5), n)), "hits beyond their bounds"),
    ("scale-mesh", altered(lambda o, d, t, n: (np.where(np.isinf(t), 1.0, t), n)), "false hits"),
    ("sliver", altered(lambda o, d, t, n: (t, -n)), "hits beyond their bounds"),
]


def of_candidate(name, call):
    return run(name, candidate=FunctionSubject("candidate", call), folder=Path("kept"))


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.slow("every family in two precisions", every=5)
def test_a_right_candidate_passes_every_family(name, precision):
    rounded = altered(lambda o, d, t, n: (t.astype(precision), n.astype(precision)))
    subject = FunctionSubject("candidate", rounded, precision)
    sweep = run(name, 0, len(BY_NAME[name].values) // 2, -1, candidate=subject)
    assert sweep.ok, sweep.problems
    assert list(sweep.settings[0].witnesses) == ["candidate", "ours", "scalar"]


@pytest.mark.parametrize(("name", "call", "says"), PLANTED)
def test_a_wrong_candidate_fails_with_the_first_ray_that_shows_it(name, call, says):
    """As a scene of one ray."""
    sweep = of_candidate(name, call)
    assert not sweep.ok and sweep.breakdowns["candidate"] and not sweep.breakdowns["ours"]
    assert all(" candidate:\n" in line for line in sweep.problems)
    first = sweep.problems[0]
    assert says in first and (": t of the answer: " in first) != (name == "sliver")
    assert name != "sliver" or re.search(r"its t is right; normal of the answer: \(.+\); expected: \(.+\)", first)
    command = shlex.split(re.search(r"\n      replay: mitsuba-ref (.+)$", first)[1])
    assert [command[0], *command[2:]] == ["probe", "0", "0"]
    setting = next(each for each in sweep.settings if each.witnesses["candidate"].breaks)
    (ray,) = setting.witnesses["candidate"].first_wrong[:1]
    ready, kept = sweeps.prepare_setting(short(name), 0, setting.x, RAYS), caster.load_scene(command[1])
    assert np.array_equal(kept.camera.origin, ready.o[ray]) and np.array_equal(kept.camera.direction, ready.d[ray])
    assert kept.shapes == ready.scene.shapes


def test_a_candidate_that_declines_or_raises_is_no_pass(here, monkeypatch, capsys, only):
    def raises(scene, o, d):
        raise ZeroDivisionError("by a determinant")

    sweep = of_candidate("tangency", raises)
    assert not sweep.ok and "no answer: candidate raised ZeroDivisionError" in sweep.problems[0]
    (here / "triangles_alone.py").write_text(
        "import caster\n"
        "def cast(scene, o, d):\n"
        "    if any(shape.type != 'mesh' for shape in scene.shapes):\n"
        "        raise NotImplementedError('no spheres')\n"
        "    hits = caster.cast(scene, o, d)\n"
        "    return hits.t, hits.normal\n"
    )
    only(short("sliver", 0, -1), short("tangency", 0, -1))
    monkeypatch.syspath_prepend(str(here))
    words = ["--rays", "25", "--candidate", "triangles_alone:cast", "--json", "run.json"]
    for selected, code, said in (
        (["sliver", "tangency"], 1, "they fail the run without --skip-unsupported"),
        (["sliver", "tangency", "--skip-unsupported"], 0, "1 declined by the candidate: tangency"),
        (["tangency", "--skip-unsupported"], 5, "nothing judged: the candidate declined every family"),
    ):
        assert main(["stress", *selected, *words]) == code
        assert said in unfolded("".join(capsys.readouterr()))
        assert json_of(here / "run.json")["ok"] == (code == 0)

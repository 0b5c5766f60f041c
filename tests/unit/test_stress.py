"""The sweeps exercise what they say, see every fault that is planted in ours, and tell all of it. Without Mitsuba."""

import json
import re
import sys
import xml.etree.ElementTree as ElementTree
from collections import Counter
from dataclasses import replace

import jsonschema
import numpy as np
import pytest
import stress_page
import stress_plots

import caster
from mitsuba_ref.__main__ import main
from mitsuba_ref.cli.doctor import result_schema
from mitsuba_ref.cli.options import select
from mitsuba_ref.reference.variants import Variants
from mitsuba_ref.report import results
from mitsuba_ref.report.results import as_json, read_result, write_result
from mitsuba_ref.stress import FAMILIES, score, sweeps
from mitsuba_ref.stress.score import Absent, Observation, Scorer
from mitsuba_ref.stress.surfaces import check_closed
from mitsuba_ref.stress.sweeps import StressRun, SweepResult
from mitsuba_ref.subjects.function import FunctionSubject

RAYS = 25
BY_NAME = {family.name: family for family in FAMILIES}
NAMES = list(BY_NAME)
REFERENCES = ("scalar", "llvm", "llvm-robust")
# What the sweeps are to be about, at least.
STRESSED = (
    "scale",
    "offset",
    "distance",
    "grazing",
    "sliver",
    "tangency",
    "watertight-edges",
    "watertight-vertices",
    "length",
    "axis",
    "condition",
    "field-of-view",
    "film-size",
    "coincident",
    "shadow",
)


@pytest.fixture(autouse=True)
def no_mitsuba(monkeypatch):
    """A machine where no variant works: the sweeps go on with ours and exact arithmetic."""
    nothing = Variants(False, False, None, "planted: nothing works")
    monkeypatch.setattr(score, "usable_variants", lambda: nothing)
    monkeypatch.setattr(results, "usable_variants", lambda: nothing)


def run(name: str, *places: int) -> SweepResult:
    """A family, or some of its settings."""
    family = BY_NAME[name]
    values = tuple(family.values[i] for i in places) or family.values
    return sweeps.sweep(replace(family, values=values), 0, RAYS)


def shortened(monkeypatch, name: str, *places: int) -> None:
    """Let a family be the only one, with some of its settings."""
    monkeypatch.setattr("mitsuba_ref.stress.FAMILIES", (short(name, *places),))


def short(name: str, *places: int):
    family = BY_NAME[name]
    return replace(family, values=tuple(family.values[i] for i in places))


@pytest.mark.parametrize("word", STRESSED)
def test_everything_that_is_to_be_stressed_is(word):
    assert any(name == word or name.startswith(f"{word}-") for name in NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_a_family_spans_decades_in_order(name):
    family = BY_NAME[name]
    positive = [x for x in family.values if x > 0.0]
    assert list(family.values) == sorted(set(family.values)) and len(family.values) >= 6
    assert positive[-1] / positive[0] >= 1e3
    assert family.values[0] <= family.easiest <= family.values[-1]


@pytest.mark.parametrize("name", NAMES)
def test_ours_is_exact_in_every_setting_and_every_setting_shows_something(name):
    sweep = run(name)
    assert sweep.ok, sweep.problems
    assert len(sweep.settings) == len(BY_NAME[name].values)
    for outcome in sweep.settings:
        ours = outcome.witnesses["ours"]
        exact = outcome.exact
        assert outcome.rays >= 16 and exact.adjudicated == outcome.rays == exact.hits + exact.misses
        assert ours.compared == exact.hits >= outcome.rays // 8
        assert exact.misses >= (outcome.rays // 10 if BY_NAME[name].misses else 0)
        assert outcome.bound.float64 > 0.0 and ours.worst <= 1.0
        assert all(outcome.witnesses[key] == Absent("missing", "planted: nothing works") for key in REFERENCES)


def test_the_screen_is_requested_where_rays_share_an_eye():
    tested = {name for name in NAMES if run(name, -1).absence("screen") is None}
    assert tested == {"watertight-edges", "watertight-vertices", "field-of-view", "film-size"}


@pytest.mark.parametrize("name", NAMES)
def test_rays_are_float32_numbers_and_depend_on_the_seed_alone(name):
    hardest = replace(BY_NAME[name], values=BY_NAME[name].values[-1:])
    first, again, other = (next(iter(hardest.settings(seed, RAYS))) for seed in (0, 0, 1))
    assert first.o.dtype == first.d.dtype == np.float32
    assert np.array_equal(first.o, again.o) and np.array_equal(first.d, again.d)
    assert not np.array_equal(first.d, other.d)


@pytest.mark.parametrize("name", ["watertight-edges", "watertight-vertices", "field-of-view", "film-size"])
def test_a_screen_casts_every_ray_of_a_setting_once(name):
    """So many that one eye does not see as many vertices."""
    setting = next(iter(BY_NAME[name].settings(0, 3000)))
    rows = np.concatenate([each.rays for each in setting.camera_rays])
    assert sorted(rows.tolist()) == list(range(len(setting.o))) and len(rows) >= 256
    assert all(len(set(each.pixels.tolist())) == len(each.pixels) for each in setting.camera_rays)


# --- planted faults


def slowed(sight: Observation) -> Observation:
    return sight._replace(t=sight.t * (1.0 + 1e-6))


def without_a_primitive(sight: Observation) -> Observation:
    gone = sight.prim == Counter(sight.prim[sight.hit].tolist()).most_common(1)[0][0]
    return Observation(np.where(gone, np.inf, sight.t), np.where(gone, -1, sight.prim))


def misnamed(sight: Observation) -> Observation:
    return sight._replace(prim=np.where(sight.hit, sight.prim + 1, -1))


def hitting_always(sight: Observation) -> Observation:
    return Observation(np.where(sight.hit, sight.t, 1.0), np.where(sight.hit, sight.prim, 0))


def not_a_number(sight: Observation) -> Observation:
    return sight._replace(t=np.where(sight.hit, np.nan, sight.t))


FAULTS = {
    slowed: ("scale-mesh", "axis", "watertight-edges", "field-of-view"),
    without_a_primitive: ("offset-mesh", "sliver", "watertight-vertices", "tangency"),
    misnamed: ("coincident-spheres", "scale-mesh"),
    hitting_always: ("tangency", "shadow-mesh"),
    not_a_number: ("grazing-disk",),
}


@pytest.mark.parametrize(("fault", "name"), [(fault, name) for fault, names in FAULTS.items() for name in names])
def test_a_fault_of_ours_fails_the_run(fault, name, monkeypatch, capsys):
    honest = score.cast_by_bvh
    monkeypatch.setattr(score, "cast_by_bvh", lambda ready: fault(honest(ready)))
    shortened(monkeypatch, name, -1)
    assert main(["stress", name, "--rays", str(RAYS)]) == 1
    shown = capsys.readouterr().out
    assert shown.startswith(f"FAIL  {name}") and f"1 of 1 families, 1 fail: {name}" in shown


def test_a_fault_of_the_screen_alone_fails_the_run(monkeypatch, capsys):
    honest = score.cast_by_raster
    monkeypatch.setattr(score, "cast_by_raster", lambda ready: without_a_primitive(honest(ready)))
    shortened(monkeypatch, "film-size", 0)
    assert main(["stress", "film-size"]) == 1
    assert "screen: " in capsys.readouterr().out


def test_the_same_settings_pass_without_a_fault(monkeypatch, capsys):
    shortened(monkeypatch, "scale-mesh", -1)
    assert main(["stress", "scale-mesh", "--rays", str(RAYS)]) == 0
    assert capsys.readouterr().out.startswith("PASS")


def test_rays_that_show_nothing_fail_the_run(monkeypatch, capsys):
    """A handful that all hit says nothing of misses."""
    family = BY_NAME["tangency"]

    def only_hits(rng, x, count):
        setting = family.make(rng, x, 100)
        sight = score.cast_by_bvh(score.prepare_setting(setting))
        return replace(setting, o=setting.o[sight.hit], d=setting.d[sight.hit])

    monkeypatch.setattr("mitsuba_ref.stress.FAMILIES", (replace(family, make=only_hits, values=(1e-2,)),))
    assert main(["stress"]) == 1
    assert "exact arithmetic has no misses" in capsys.readouterr().out


def test_an_open_mesh_is_no_closed_one():
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [3, 2, 1]])
    check_closed(faces)
    for broken in (faces[:-1], np.concatenate([faces, faces[:1]]), np.concatenate([faces[:-1], [[1, 2, 3]]])):
        with pytest.raises(ValueError, match="not closed"):
            check_closed(broken)


def test_a_closed_mesh_that_exact_arithmetic_gets_out_of_is_an_error():
    ready = score.prepare_setting(replace(next(iter(BY_NAME["tangency"].settings(0, RAYS))), closed=True))
    with pytest.raises(AssertionError, match="leaves a closed mesh"):
        score.exact_answers(ready, np.zeros(RAYS, bool))


# --- scores


@pytest.fixture(scope="module")
def ball() -> tuple[Scorer, Observation]:
    """One sphere on another: every hit is a tie."""
    family = BY_NAME["coincident-spheres"]
    ready = score.prepare_setting(family.make(np.random.default_rng(3), 0.0, RAYS))
    return Scorer(ready, score.exact_answers(ready, np.zeros(RAYS, bool))), score.cast_by_bvh(ready)


def test_any_member_of_a_tie_is_right(ball):
    scorer, sight = ball
    second = sight._replace(prim=np.where(sight.hit, 1, -1))
    for said in (sight, second):
        assert not scorer.score(said, ours=True).fails
    assert scorer.score(misnamed(second), ours=True).wrong_primitives == sight.hit.sum() > 0


def test_each_kind_of_mistake_is_counted_as_what_it_is(ball):
    scorer, sight = ball
    hits = int(sight.hit.sum())
    lost = scorer.score(Observation(np.full(RAYS, np.inf), np.full(RAYS, -1)), ours=True)
    assert (lost.false_misses, lost.compared, lost.error, lost.breaks) == (hits, 0, None, True)
    assert scorer.score(hitting_always(sight), ours=True).false_hits == RAYS - hits > 0
    broken = scorer.score(not_a_number(sight), ours=True)
    assert (broken.beyond, broken.wrong_masks) == (hits, 0)


def test_float32_may_be_as_far_off_as_its_bound_and_ours_may_not(ball):
    scorer, sight = ball
    rounded = sight._replace(t=sight.t.astype(np.float32).astype(np.float64))
    theirs, ours = (scorer.score(rounded, ours=whose) for whose in (False, True))
    assert not theirs.breaks and 0.0 < theirs.worst < 1.0
    assert ours.beyond > 0 and ours.worst > 1.0
    assert theirs.error == ours.error and 1e-9 < theirs.error < 2.0**-24


# --- what is told


def test_the_first_breakdown_is_looked_for_on_both_sides_of_the_easiest_setting():
    sweep = run("scale-sphere")
    wrong = {0: 1, 2: 1, 15: 1, 16: 1}
    outcomes = [
        replace(
            outcome,
            witnesses=outcome.witnesses | {"ours": replace(outcome.witnesses["ours"], false_hits=wrong.get(i, 0))},
        )
        for i, outcome in enumerate(sweep.settings)
    ]
    broken = replace(sweep, settings=tuple(outcomes))
    x = BY_NAME["scale-sphere"].values
    assert sweep.breakdowns["ours"] == [] and broken.breakdowns["ours"] == [x[2], x[15]]
    assert "ours 1e-20 and 1e+18" in sweeps.as_text(broken) and not broken.ok


def test_the_json_has_its_keys_and_the_same_numbers_again(monkeypatch, capsys):
    shortened(monkeypatch, "film-size", 0, 1)
    texts = []
    for _ in range(2):
        assert main(["stress", "--json", "-", "--rays", str(RAYS)]) == 0
        shown = capsys.readouterr()
        texts.append(json.loads(shown.out))
        assert shown.err.startswith("PASS  film-size")
    first = texts[0]
    keys = {"format", "seed", "versions", "requested", "skip_unsupported", "ok", "families"}
    assert set(first) == keys and first["format"] == 1
    (family,) = first["families"]
    assert set(family) == {
        *("name", "title", "quantity", "error", "easiest", "misses"),
        *("ok", "problems", "seconds", "declined", "breakdowns", "settings"),
    }
    setting = family["settings"][0]
    assert set(setting) == {"x", "rays", "exact", "bound", "witnesses"}
    assert set(setting["exact"]) == {"adjudicated", "hits", "misses", "ties"}
    assert set(setting["bound"]) == {"float32", "float64", "unresolved"}
    assert list(setting["witnesses"]) == ["ours", "screen", *REFERENCES]
    assert setting["witnesses"]["llvm"] == {"status": "missing", "why": "planted: nothing works"}
    assert set(setting["witnesses"]["ours"]) == {
        *("status", "false_hits", "false_misses", "wrong_primitives", "beyond", "compared", "worst", "error"),
        *("median", "first_wrong", "excused", "example"),
    }
    for text in texts:
        text["families"][0].pop("seconds")
    assert texts[0] == texts[1]


def test_what_is_missing_is_stated_in_table_image_and_json():
    sweep = run("tangency", 0, -1)
    assert "Mitsuba LLVM, robust: missing: planted: nothing works" in sweeps.as_text(sweep)
    assert b"Mitsuba LLVM, robust: missing" in stress_plots.as_svg(sweep)
    text = json.dumps(as_json(StressRun(0, {}, ("tangency",), (sweep,))))
    assert text.count('"status": "missing"') == 3 * len(sweep.settings)


def test_leaks_are_added_up(monkeypatch):
    honest = score.cast_by_bvh
    monkeypatch.setattr(score, "cast_by_bvh", lambda ready: without_a_primitive(honest(ready)))
    sweep = run("watertight-vertices", 0, 1)
    lost = sum(outcome.witnesses["ours"].false_misses for outcome in sweep.settings)
    assert lost > 0 and f"leaks of {2 * RAYS} rays: ours {lost}, screen 0, scalar missing" in sweeps.as_text(sweep)


@pytest.mark.parametrize("name", ["watertight-edges", "scale-mesh"])
def test_an_image_is_well_formed_small_and_the_same_again(name):
    sweep = run(name, 0, 1, -1)
    picture = stress_plots.as_svg(sweep)
    words = " ".join(ElementTree.fromstring(picture).itertext())
    assert picture == stress_plots.as_svg(sweep) and len(picture) < 90_000
    for word in (sweep.quantity, sweep.error, "ours, by BVH", "predicted bound of float32"):
        assert word in words
    assert ("ours, by rasterization" in words) == name.startswith("watertight")


def test_the_page_is_made_from_the_json_of_a_run(tmp_path, monkeypatch):
    shortened(monkeypatch, "tangency", -2, -1)
    file = tmp_path / "run.json"
    assert main(["stress", "--json", str(file), "--rays", str(RAYS)]) == 0
    monkeypatch.setattr(sys, "argv", ["stress_page.py", str(file), str(tmp_path)])
    stress_page.main()
    page = " ".join((tmp_path / "stress.md").read_text().split())
    assert "In 1 sweeps, 2 settings and 50 rays, 50 of them decided by exact arithmetic" in page
    assert "**0 wrong hits or misses, 0 wrong primitives and 0 errors" in page
    assert "(stress/tangency.svg)" in page and (tmp_path / "stress/tangency.svg").is_file()


def test_json_brings_the_run_back_and_satisfies_its_schema(tmp_path):
    run_ = StressRun(0, {"numpy": "2"}, ("tangency", "axis"), (run("tangency", 0), run("axis", -1)))
    file = str(tmp_path / "run.json")
    write_result(run_, file)
    assert read_result(StressRun, file, "mitsuba-ref stress") == run_
    jsonschema.validate(as_json(run_), result_schema("stress"))


# --- the command


def test_a_part_of_the_name_selects_all_that_begin_with_it():
    assert [family.name for family in select(FAMILIES, "family", ["watertight"], None)] == NAMES[10:12]
    assert [family.name for family in select(FAMILIES, "family", ["axis", "scale-mesh"], None)] == [
        "scale-mesh",
        "axis",
    ]
    assert [family.name for family in select(FAMILIES, "family", [], "shadow and not mesh")] == ["shadow-sphere"]


@pytest.mark.parametrize(
    ("options", "code", "says"),
    [
        (["watertigth"], 2, "did you mean 'watertight'?"),
        (["-k", "nothing-like-it"], 5, "no family matches"),
        (["-k", "and"], 2, "a part of a name is missing"),
        (["--rays", "0"], 2, "expected a whole number >= 1"),
        (["--seed", "-1"], 2, "expected a whole number >= 0"),
        (["--json", "/no/such/folder/x.json"], 4, "/no/such/folder"),
    ],
)
def test_wrong_usage_ends_at_once(options, code, says, capsys):
    assert main(["stress", *options]) == code
    assert says in capsys.readouterr().err


def test_the_list_names_all_families(capsys):
    assert main(["stress", "--list"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == NAMES


def test_ctrl_c_keeps_what_is_done(tmp_path, monkeypatch, capsys):
    honest = sweeps.sweep

    def interrupted(family, *rest):
        if family.name == "offset-sphere":
            raise KeyboardInterrupt
        return honest(family, *rest)

    monkeypatch.setattr(sweeps, "sweep", interrupted)
    out = tmp_path / "out.json"
    assert main(["stress", "offset", "--rays", str(RAYS), "--json", str(out)]) == 130
    kept = json.loads(out.read_text())
    assert [family["name"] for family in kept["families"]] == ["offset-mesh"]
    assert kept["requested"] == ["offset-mesh", "offset-sphere"] and not kept["ok"]
    assert "1 of 2 families" in capsys.readouterr().out


# ---- a candidate in place of ours ----


def right(scene, o, d):
    found = caster.cast(scene, o, d)
    return found.t, found.normal


def altered(change):
    """The right caster, its (t, normal) changed by a function of the rays as well."""

    def cast(scene, o, d):
        return change(o, d, *right(scene, o, d))

    return cast


def only_if(keep):
    """A caster that misses where keep(o, d, t, n) does not hold."""
    return altered(lambda o, d, t, n: (np.where(keep(o, d, t, n), t, np.inf), n))


LEAK = only_if(lambda o, d, t, n: np.arange(len(t)) % 7 != 0)
GRAZING_EPSILON = only_if(lambda o, d, t, n: np.abs((d * n).sum(axis=1)) > 1e-6)
LENGTH_EPSILON = only_if(lambda o, d, t, n: np.linalg.norm(d, axis=1) > 1e-8)
PLANTED = [
    ("watertight-edges", LEAK, "4 false misses"),
    ("grazing-rectangle", GRAZING_EPSILON, "false misses"),
    ("length-mesh", LENGTH_EPSILON, "false misses"),
    ("tangency", altered(lambda o, d, t, n: (t * (1 + 1e-5), n)), "hits beyond their bounds"),
    ("scale-mesh", altered(lambda o, d, t, n: (np.where(np.isinf(t), 1.0, t), n)), "false hits"),
    ("sliver", altered(lambda o, d, t, n: (t, -n)), "hits beyond their bounds"),
    (
        "axis",
        altered(lambda o, d, t, n: (np.where(np.arange(len(t)) % 5 == 0, np.nan, t), n)),
        "hits beyond their bounds",
    ),
]


def of_candidate(name, call):
    return sweeps.sweep(BY_NAME[name], 0, RAYS, candidate=FunctionSubject("candidate", call))


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.slow("every family in two precisions", every=3)
def test_a_right_candidate_passes_every_family(name, precision):
    rounded = altered(lambda o, d, t, n: (t.astype(precision), n.astype(precision)))
    subject = FunctionSubject("candidate", rounded, precision)
    sweep = sweeps.sweep(short(name, 0, len(BY_NAME[name].values) // 2, -1), 0, RAYS, candidate=subject)
    assert sweep.ok, sweep.problems
    assert list(sweep.settings[0].witnesses) == ["candidate", "ours", "scalar"]
    for setting in sweep.settings:
        score = setting.witnesses["candidate"]
        assert not score.fails and score.compared >= setting.exact.hits - score.excused


@pytest.mark.parametrize(("name", "call", "says"), PLANTED)
def test_a_wrong_candidate_fails_with_the_first_ray_that_shows_it(name, call, says):
    sweep = of_candidate(name, call)
    assert not sweep.ok and sweep.breakdowns["candidate"] and not sweep.breakdowns["ours"]
    assert all(" candidate: " in line for line in sweep.problems)
    first = sweep.problems[0]
    assert says in first and ": the candidate has a" in first
    o, d = re.search(r": o (0x\S+|-0x\S+) .*?, d (\S+) ", first).groups()
    assert np.isfinite([float.fromhex(o), float.fromhex(d)]).all()


def test_a_candidate_that_declines_or_raises_is_no_pass():
    def declines(scene, o, d):
        raise NotImplementedError("no spheres")

    def raises(scene, o, d):
        raise ZeroDivisionError("by a determinant")

    sweep = of_candidate("tangency", raises)
    assert not sweep.ok and "no answer: candidate raised ZeroDivisionError" in sweep.problems[0]
    sweep = of_candidate("tangency", declines)
    assert not sweep.ok and "declined every setting" in sweep.problems[0]


def test_families_that_a_candidate_declines_are_skipped_where_that_is_requested(tmp_path, monkeypatch, capsys):
    families = (short("sliver", 0, -1), short("tangency", 0, -1))
    monkeypatch.setattr("mitsuba_ref.stress.FAMILIES", families)
    (tmp_path / "triangles_alone.py").write_text(
        "import caster\n"
        "def cast(scene, o, d):\n"
        "    if any(shape.type != 'mesh' for shape in scene.shapes):\n"
        "        raise NotImplementedError('no spheres')\n"
        "    hits = caster.cast(scene, o, d)\n"
        "    return hits.t, hits.normal\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    words = ["--rays", "25", "--candidate", "triangles_alone:cast", "--json", "run.json"]

    assert main(["stress", "sliver", "tangency", *words]) == 1
    out = capsys.readouterr().out
    assert "FAIL  tangency" in out and "they fail the run without --skip-unsupported" in out
    assert not json.loads((tmp_path / "run.json").read_text())["ok"]

    assert main(["stress", "sliver", "tangency", "--skip-unsupported", *words]) == 0
    out = capsys.readouterr().out
    assert "SKIP  tangency" in out and "PASS  sliver" in out and "1 declined by the candidate: tangency" in out
    run = json.loads((tmp_path / "run.json").read_text())
    assert run["ok"] and [bool(each["declined"]) for each in run["families"]] == [False, True]

    assert main(["stress", "tangency", "--skip-unsupported", *words]) == 5
    assert "nothing judged: the candidate declined every family" in capsys.readouterr().err
    assert not json.loads((tmp_path / "run.json").read_text())["ok"]


def test_the_command_judges_a_candidate_and_refuses_one_without_rays(tmp_path, monkeypatch, capsys):
    shortened(monkeypatch, "sliver", 0, -1)
    (tmp_path / "somebodys_caster.py").write_text(
        "import caster\ndef cast(scene, o, d):\n    hits = caster.cast(scene, o, d)\n    return hits.t, -hits.normal\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    words = ["stress", "sliver", "--rays", "25", "--candidate"]
    assert main([*words, "somebodys_caster:cast"]) == 1
    out = capsys.readouterr().out
    assert "FAIL  sliver" in out and "candidate" in out.splitlines()[1] and "1 fail: sliver" in out
    assert main([*words, "true {xml} -o {exr}"]) == 2
    assert "expected one that casts rays it is given" in capsys.readouterr().err

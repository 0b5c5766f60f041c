"""The list of a scene's checks, and what a verdict says about those that only --thorough makes."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from verdict_factory import scene, verdict

from caster.description.errors import SceneError
from mitsuba_ref.cli import options
from mitsuba_ref.judge import CANDIDATE, OURS, SCENE_CHECKS, THOROUGH_CHECKS, check_names
from mitsuba_ref.report.ci_summaries import junit, markdown
from mitsuba_ref.report.reproducers import replay
from mitsuba_ref.report.validation import MADE_OF_SCENE
from mitsuba_ref.report.verdict_text import failure_text, summary_text
from mitsuba_ref.runner.many_scenes import load_entry
from mitsuba_ref.runner.resume import inputs_hash

ROOT = Path(__file__).resolve().parents[2]
LEFT_OUT = "brute_force, scaling, routes"


def test_the_method_page_lists_the_checks_and_marks_the_thorough_ones():
    """The page also has `files`, of what --out writes."""
    page = (ROOT / "docs/method.md").read_text()
    table = page[page.index("| check of a scene |") :].partition("\n\n")[0]
    rows = {name: whose for name, whose in re.findall(r"^\| `(\w+)` \| .* \| ([^|]*) \|$", table, re.MULTILINE)}
    assert rows.keys() - {"files"} == {check.name for check in SCENE_CHECKS}
    assert {name for name, whose in rows.items() if "thorough" in whose} == {*THOROUGH_CHECKS}
    for check in SCENE_CHECKS:
        assert (rows[check.name].startswith("ours")) is (check.of == (OURS,)), check


def test_thorough_checks_are_of_our_caster_and_nothing_else_is_left_out():
    assert set(THOROUGH_CHECKS) < set(MADE_OF_SCENE) | {"routes"}
    assert set(check_names(OURS)) - set(check_names(OURS, thorough=False)) == set(THOROUGH_CHECKS)
    assert check_names(CANDIDATE) == check_names(CANDIDATE, thorough=False)


def test_what_was_not_made_is_named_and_what_was_made_is_not():
    plain, thorough = scene("a"), scene("b", thorough=True)
    assert plain.left_out == THOROUGH_CHECKS and plain.to_dict()["left_out"] == list(THOROUGH_CHECKS)
    assert thorough.left_out == () and scene("c", candidate="theirs").left_out == ()
    assert f"left out:   {LEFT_OUT}: tests" in summary_text(verdict(plain), 1.0)
    assert f"left out:   {LEFT_OUT} in 1 of 2 scenes: tests" in summary_text(verdict(plain, thorough), 1.0)
    assert "left out" not in summary_text(verdict(thorough), 1.0)
    for page, name in ((markdown(verdict(plain), 1.0), "brute&#95;force"), (junit(verdict(plain)), "brute_force")):
        assert f"left out: {name}" in page
    assert "left out" not in markdown(verdict(thorough), 1.0) + junit(verdict(thorough))


def test_no_check_is_left_out_of_a_scene_without_any():
    assert scene("a", ok=False, problem="crash").left_out == ()


def test_a_replay_makes_the_checks_that_were_made():
    fails = replace(scene(), checks=(replace(scene().checks[0], ratio=7.0),))
    assert "replay:    mitsuba-ref validate scenes/ball.toml\n" in f"{failure_text(fails)}\n"
    assert "replay:    mitsuba-ref validate scenes/ball.toml --thorough\n" in (
        f"{failure_text(replace(fails, thorough=True))}\n"
    )
    assert replay(replace(fails, thorough=True), (3, 4)) == "mitsuba-ref probe scenes/ball.toml 3 4"


def test_a_verdict_without_them_is_not_reused_for_one_with_them():
    entry = load_entry(str(ROOT / "scenes/one-sphere.toml"), "one-sphere")
    assert inputs_hash(entry) == inputs_hash(entry, thorough=False) != inputs_hash(entry, thorough=True) != ""


def test_a_candidate_has_none_of_them():
    asked = type("Asked", (), {"candidate": "a:b", "candidate_precision": None, "thorough": True})
    with pytest.raises(SceneError, match="--thorough: not with --candidate"):
        options.requested_candidate(asked)

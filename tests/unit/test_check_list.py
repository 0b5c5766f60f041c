"""The registry of a scene's checks, and what a verdict says about those that only --thorough makes."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from verdict_factory import scene, verdict

from caster import Pinhole, Scene
from caster.description.errors import SceneError
from mitsuba_ref.cli import options
from mitsuba_ref.judge.checks import CANDIDATE, OURS, all_checks, checks_of, make_checks, thorough_names
from mitsuba_ref.judge.checks.shapes import check_materials
from mitsuba_ref.judge.verdict import SceneCheck
from mitsuba_ref.report.ci_summaries import junit, markdown
from mitsuba_ref.report.reproducers import replay
from mitsuba_ref.report.verdict_text import failure_text, summary_text

ROOT = Path(__file__).resolve().parents[2]
LEFT_OUT = "brute_force, routes, scaling"


def test_the_method_page_lists_the_checks_and_marks_the_thorough_ones():
    """The page also has `files`, of what --out writes."""
    page = (ROOT / "docs/method.md").read_text()
    table = page[page.index("| check of a scene |") :].partition("\n\n")[0]
    rows = {name: whose for name, whose in re.findall(r"^\| `(\w+)` \| .* \| ([^|]*) \|$", table, re.MULTILINE)}
    assert rows.keys() - {"files"} == {check.name for check in all_checks()}
    assert {name for name, whose in rows.items() if "thorough" in whose} == {*thorough_names()}
    for check in all_checks():
        assert (rows[check.name].startswith("ours")) is (check.of == (OURS,)), check


def test_thorough_checks_are_of_our_caster_and_nothing_else_is_left_out():
    assert ", ".join(sorted(thorough_names())) == LEFT_OUT
    assert set(checks_of(OURS)) - set(checks_of(OURS, thorough=False)) == {
        check for check in all_checks() if check.thorough
    }
    assert checks_of(CANDIDATE) == checks_of(CANDIDATE, thorough=False)


def test_a_check_gets_what_it_names_and_may_have_no_result():
    first = next(check for check in all_checks() if check.name == "routes")
    made = first._replace(make=lambda subject: SceneCheck("routes", 0.0, subject), needs=("subject",))
    none = first._replace(make=lambda scene: None, needs=("scene",))
    found = make_checks([made, none], {"subject": "here", "scene": None})
    assert [check.what for check in found] == ["here"]


def test_a_scene_without_shapes_has_its_materials():
    empty = Scene(camera=Pinhole(**Pinhole.MINIMAL), shapes=[])
    assert check_materials(empty) == SceneCheck("materials", 0.0, "no shape")


def test_what_was_not_made_is_named_and_what_was_made_is_not():
    plain, thorough = scene("a", left_out=("brute_force", "routes", "scaling")), scene("b", thorough=True)
    assert f"left out:   {LEFT_OUT}: tests" in summary_text(verdict(plain), 1.0)
    assert f"left out:   {LEFT_OUT} in 1 of 2 scenes: tests" in summary_text(verdict(plain, thorough), 1.0)
    assert "left out" not in summary_text(verdict(thorough), 1.0)
    for page, name in ((markdown(verdict(plain), 1.0), "brute&#95;force"), (junit(verdict(plain)), "brute_force")):
        assert f"left out: {name}" in page
    assert "left out" not in markdown(verdict(thorough), 1.0) + junit(verdict(thorough))


def test_a_replay_makes_the_checks_that_were_made():
    fails = replace(scene(), checks=(replace(scene().checks[0], ratio=7.0),))
    assert "replay:    mitsuba-ref validate scenes/ball.toml\n" in f"{failure_text(fails)}\n"
    assert "replay:    mitsuba-ref validate scenes/ball.toml --thorough\n" in (
        f"{failure_text(replace(fails, thorough=True))}\n"
    )
    assert replay(replace(fails, thorough=True), (3, 4)) == "mitsuba-ref probe scenes/ball.toml 3 4"


def test_a_candidate_has_none_of_them():
    asked = type("Asked", (), {"candidate": "a:b", "candidate_precision": None, "thorough": True})
    with pytest.raises(SceneError, match="--thorough: not with --candidate"):
        options.requested_candidate(asked)

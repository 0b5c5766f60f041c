"""The registry of a scene's checks."""

import re

from places import ROOT

from caster import Pinhole, Scene
from mitsuba_ref.judge.checks import OURS, all_checks, checks_of
from mitsuba_ref.judge.checks.shapes import check_materials
from mitsuba_ref.judge.verdict import SceneCheck


def test_the_method_page_lists_the_checks():
    page = (ROOT / "docs/method.md").read_text()
    table = page[page.index("| check of a scene |") :].partition("\n\n")[0]
    rows = {name: whose for name, whose in re.findall(r"^\| `(\w+)` \| .* \| ([^|]*) \|$", table, re.MULTILINE)}
    assert rows.keys() == {check.name for check in all_checks()}
    for check in all_checks():
        assert (rows[check.name] == "ours") is (check.of == (OURS,)), check


def test_only_thorough_adds_the_checks_beyond_the_film():
    added = {check.name for check in checks_of(OURS, thorough=True)} - {check.name for check in checks_of(OURS)}
    assert added == {"routes", "scaling"}


def test_a_scene_without_shapes_has_its_materials():
    empty = Scene(camera=Pinhole(**Pinhole.MINIMAL), shapes=[])
    assert check_materials(empty) == SceneCheck("materials", 0.0, "nothing to look at")

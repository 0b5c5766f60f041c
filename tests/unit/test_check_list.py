"""The registry of a scene's checks."""

import re

from places import ROOT, scene_of

from mitsuba_ref.judge.checks import OURS, all_checks
from mitsuba_ref.judge.checks.shapes import check_materials
from mitsuba_ref.judge.verdict import SceneCheck


def test_the_method_page_lists_the_checks():
    page = (ROOT / "docs/method.md").read_text()
    table = page[page.index("| check of a scene |") :].partition("\n\n")[0]
    rows = {name: whose for name, whose in re.findall(r"^\| `(\w+)` \| .* \| ([^|]*) \|$", table, re.MULTILINE)}
    assert rows.keys() == {check.name for check in all_checks()}
    for check in all_checks():
        assert (rows[check.name] == "ours") is (check.of == (OURS,)), check


def test_a_scene_without_shapes_has_its_materials():
    assert check_materials(scene_of()) == SceneCheck("materials", 0.0, "nothing to look at")

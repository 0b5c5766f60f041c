"""docs/architecture.py: the figures of small import graphs worked out by hand, and the drawing of packages."""

import ast
import re
import sys
from itertools import combinations
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "docs"))

import architecture  # noqa: E402
import layered_drawing  # noqa: E402
from layered_drawing import Box, drawing, longest_path_layers, spread, transitive_reduction  # noqa: E402


def tree(root: Path, **files: str) -> Path:
    """Modules by their dotted names, with __ for the dots."""
    for name, source in files.items():
        path = root / "caster" / (name.replace("__", "/") + ".py")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(source)
    return root


def test_figures_of_a_tree(tmp_path):
    root = tree(
        tmp_path,
        top="from caster.a import A\nfrom caster.b import B\n",
        a="def f():\n    import caster.c\n",
        b="from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from caster.d import D\n",
        c="from .d import D\n",
        d="from caster.c import C\n",
    )
    (root / "caster/kinds").mkdir()
    (root / "caster/kinds/__init__.py").write_text("from caster.kinds.one import ONE\n")
    (root / "caster/kinds/one.py").write_text("from caster.d import D\n")
    found = architecture.figures(root)
    assert found["lines"] == 11 and found["files"] == 7
    assert found["circles"] == [["caster.c", "caster.d"]]
    assert found["layers"] == 3 and found["longest_chain"] == ["caster.kinds", "caster.kinds.one", "caster.d"]
    assert found["one_importer"] == ["caster.a", "caster.b"]
    assert found["one_importer_registry_members"] == ["caster.kinds.one"]
    assert len(found["flat_in_roots"]) == 5 and found["crowded_packages"] == {}
    assert found["repeated_file_names"] == {}


def test_a_package_of_thirteen_modules_is_crowded(tmp_path):
    tree(tmp_path, **{f"render__m{i}": "" for i in range(12)}, render____init__="", image__m1="")
    assert architecture.figures(tmp_path)["crowded_packages"] == {}
    tree(tmp_path, render__m12="")
    found = architecture.figures(tmp_path)
    assert found["crowded_packages"] == {"caster/render": 13} and found["repeated_file_names"] == {"m1.py": 2}


def test_layers_go_down_and_reduction_keeps_what_is_reached():
    edges = [("a", "b"), ("b", "c"), ("a", "c"), ("a", "d")]
    assert longest_path_layers("abcd", edges) == {"a": 0, "b": 1, "c": 2, "d": 1}
    assert transitive_reduction(edges) == [("a", "b"), ("a", "d"), ("b", "c")]
    with pytest.raises(ValueError, match="a circle: a -> b -> a"):
        longest_path_layers("ab", [("a", "b"), ("b", "a")])


def test_boxes_are_spread_no_closer_than_the_gap():
    widths = [100.0, 40.0, 60.0]
    places = spread([50.0, 50.0, 900.0], widths)
    assert places[1] - places[0] == pytest.approx(70.0 + layered_drawing.GAP)
    assert (places[0] + places[1]) / 2 == pytest.approx(50.0) and places[2] == 900.0


def rectangles(svg: str) -> list[tuple[float, ...]]:
    found = re.findall(r'<rect class="(?:first|second)" x="(\S+)" y="(\S+)" width="(\S+)" height="(\S+)"', svg)
    return [tuple(map(float, each)) for each in found]


def test_no_box_and_no_weight_of_the_image_covers_another():
    svg = architecture.picture()
    boxes = rectangles(svg)
    assert len(boxes) == len(architecture.FLOW)
    for (x, y, w, h), (u, v, s, t) in combinations(boxes, 2):
        assert x + w <= u or u + s <= x or y + h <= v or v + t <= y
    weights = [(float(x), float(y)) for x, y in re.findall(r'<text class="weight" x="(\S+)" y="(\S+)"', svg)]
    for (x, y), (u, v) in combinations(weights, 2):
        assert abs(x - u) >= 10.0 or abs(y - v) >= 10.0
    for x, y in weights:
        assert not any(left < x < left + w and top < y - 4 < top + h for left, top, w, h in boxes)


def test_equal_graphs_give_equal_bytes():
    boxes = [Box(name, "caption", "first") for name in "abcdef"]
    weights = {("a", "b"): 1, ("a", "f"): 2, ("b", "c"): 3, ("b", "e"): 40, ("c", "f"): 5, ("d", "f"): 6}
    one = drawing(boxes, dict(sorted(weights.items())), ["note"])
    assert one == drawing(boxes, dict(sorted(weights.items())), ["note"])
    assert one.count('class="arrow"') == len(weights) and ">40</text>" in one


MAX_FILES = 260
MAX_PACKAGE_LAYERS = 12
MAX_SINGLE_IMPORTERS = 40


def test_the_tree_stays_within_its_limits():
    """Circles, and imports against the flow, are the contract's (tests/unit/test_imports.py)."""
    found = architecture.figures()
    assert found["crowded_packages"] == {}, "a package of more than 12 modules"
    assert found["files"] <= MAX_FILES, "fold a fragment into the file of its subject"
    assert found["package_layers"] <= MAX_PACKAGE_LAYERS
    assert len(found["one_importer"]) <= MAX_SINGLE_IMPORTERS, found["one_importer"]


PAGE = (ROOT / "docs/ARCHITECTURE.md").read_text(encoding="utf-8")


def test_the_committed_image_is_current():
    current = (ROOT / "docs/architecture.svg").read_text(encoding="utf-8") == architecture.picture()
    assert current, "run python docs/architecture.py --svg docs/architecture.svg"


def test_the_table_of_folders_is_the_flow():
    folders = re.findall(r"^\| `((?:caster|mitsuba_ref)/\w+)` \|", PAGE, re.MULTILINE)
    assert [folder.replace("/", ".") for folder in folders] == list(architecture.FLOW)


@pytest.mark.parametrize("place", sorted(set(re.findall(r"`((?:caster|mitsuba_ref)/[\w/.]+(?::[\w.]+)?)`", PAGE))))
def test_what_the_page_names_is_there(place):
    path, _, name = place.partition(":")
    assert (ROOT / path).exists()
    body = ast.parse((ROOT / path).read_text(encoding="utf-8")).body if name else []
    for part in name.split(".") if name else []:
        found = [each for each in body if getattr(each, "name", None) == part]
        assert found, f"{path} defines no {part}"
        body = found[0].body

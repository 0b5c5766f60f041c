"""What the README says about speed is what the run of docs/performance.md measured."""

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
OTHERS = ("raw-robust", "aov-robust", "open3d", "trimesh")  # columns of the table, after ours


def table() -> dict[str, list[str]]:
    """By scene, the cells of the README's table of run times."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    section = text.partition("## How fast")[2].partition("\n## ")[0]
    rows = [re.split(r"\s*\|\s*", line.strip("| ")) for line in section.splitlines() if line.startswith("|")]
    return {cells[0]: cells[1:] for cells in rows[2:]}


def measured() -> dict[str, list[str]]:
    run = json.loads((ROOT / "docs/performance/run.json").read_text(encoding="utf-8"))
    found = {}
    for scene in run["scenes"]:
        rows = {row["key"]: row for row in scene["rows"]}
        if "ours" in rows:
            ratios = [rows.get(key, {}).get("ratio") for key in OTHERS]
            found[scene["name"]] = [
                f"{rows['ours']['ns']:.1f}",
                *("-" if ratio is None else f"{ratio:.1f}" for ratio in ratios),
            ]
    return found


def test_each_number_is_that_of_the_run():
    told, run = table(), measured()
    assert len(told) >= 10 and told.keys() <= run.keys()
    assert told == {name: run[name] for name in told}


@pytest.mark.parametrize("column", range(5))
def test_a_number_that_is_another_is_detected(column):
    told, run = table(), measured()
    name, cells = next((name, cells) for name, cells in told.items() if cells[column] != "-")
    cells[column] = f"{float(cells[column]) + 0.1:.1f}"
    assert run[name] != cells


def test_pages_and_images_are_there():
    page = (ROOT / "docs/performance.md").read_text(encoding="utf-8")
    pictures = re.findall(r"\]\((performance/[^)]+)\)", page)
    assert len(pictures) >= 4 and all((ROOT / "docs" / name).exists() for name in pictures)

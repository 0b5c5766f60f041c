"""What the README says about speed is what the run of docs/performance.md measured."""

import re
from pathlib import Path

import performance_page
import pytest

from mitsuba_ref.bench.result import Run
from mitsuba_ref.report.results import read_result

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def run() -> Run:
    return read_result(Run, str(ROOT / "docs/performance/run.json"), "mitsuba-ref bench")


@pytest.fixture
def readme() -> str:
    return (ROOT / "README.md").read_text(encoding="utf-8")


def rows(text: str) -> list[str]:
    section = text.partition(performance_page.README_SECTION)[2].partition("\n## ")[0]
    return [line for line in section.splitlines() if line.startswith("|")]


def test_each_number_is_that_of_the_run(readme, run):
    assert len(rows(readme)) >= 12
    assert performance_page.with_tables(readme, run) == readme


def test_a_number_that_is_another_is_detected(readme, run):
    line = rows(readme)[4]
    first = re.search(r"\d+\.\d", line).group()
    other = readme.replace(line, line.replace(first, f"{float(first) + 0.1:.1f}", 1))
    mended = performance_page.with_tables(other, run)
    assert other != readme and mended == readme


def test_a_scene_that_is_left_out_is_detected(readme, run):
    """A table of the best cases is none of the run."""
    line = rows(readme)[5]
    assert performance_page.with_tables(readme.replace(f"{line}\n", ""), run) == readme


def test_pages_and_images_are_there():
    page = (ROOT / "docs/performance.md").read_text(encoding="utf-8")
    pictures = re.findall(r"\]\((performance/[^)]+)\)", page)
    assert len(pictures) >= 1 and all((ROOT / "docs" / name).exists() for name in pictures)

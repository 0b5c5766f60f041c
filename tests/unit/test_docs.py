"""The pages of docs/: what is made from sources is up to date, no link leads nowhere, every page can be found."""

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("docs/*.md"), ROOT / "README.md"])
LINK = re.compile(r"\]\(([^)#\s]+)(#[^)\s]*)?\)")
MADE_BY_ANOTHER = {"performance-notes.md"}  # taken into performance.md


def links_of(page: Path) -> list[str]:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return [target for target, _ in LINK.findall(text) if "://" not in target]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_to_a_file(page):
    gone = [target for target in links_of(page) if not (page.parent / target).exists()]
    assert not gone


def test_the_index_names_every_page():
    named = set(links_of(ROOT / "docs/README.md"))
    there = {page.name for page in ROOT.glob("docs/*.md")} - {"README.md"} - MADE_BY_ANOTHER
    assert named == there


def program(name):
    """A program of docs/ as a module."""
    spec = importlib.util.spec_from_file_location(f"{name}_page", ROOT / f"docs/{name}.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_api_page_is_what_the_docstrings_say():
    written = (ROOT / "docs/api.md").read_text(encoding="utf-8")
    assert written == program("api").page(), "run python docs/api.py"


def test_every_planted_fault_has_its_row():
    faults, written = program("faults"), (ROOT / "docs/faults.md").read_text(encoding="utf-8")
    rows = faults.rows_of_page(written)
    assert not faults.missing(rows), "run python docs/faults.py, with -k for some of them"
    assert written == faults.page(rows) and len(rows) > 250
    assert faults.missing(dict(list(rows.items())[1:])) == [
        f"{faults.TABLES[0].module}: {faults.planted(faults.TABLES[0])[0][0]}"
    ]


@pytest.mark.parametrize(
    ("said", "by", "message"),
    [
        ("PASS  a  1\nFAIL  a    12  0.1\n\nFAIL  a  uv: 3 wrong", "`uv` of a", "3 wrong"),
        ("x: FAIL  judged: wrong: diffuse", "fuzz: judged", "wrong: diffuse"),
        ("x: caught by fuzz as t, miss", "fuzz: t, miss", "t, miss"),
        ("FAILED tests/unit/test_x.py::test_y[1] - assert 1 == 2", "`tests/unit/test_x.py::test_y`", "assert 1 == 2"),
        ("", "`tests/t.py::test_z`", "other numbers than NumPy's or plain Python's"),
    ],
)
def test_a_row_names_what_caught_the_fault(said, by, message):
    assert program("faults").caught(said, "tests/t.py::test_z[fault]") == (by, message)

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


def test_the_api_page_is_what_the_docstrings_say():
    spec = importlib.util.spec_from_file_location("api_page", ROOT / "docs/api.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert (ROOT / "docs/api.md").read_text(encoding="utf-8") == module.page(), "run python docs/api.py"

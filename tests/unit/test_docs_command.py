"""`mitsuba-ref docs`: every page is in the wheel and can be read in the terminal."""

import re
import sys

import pytest
from places import PYPROJECT, ROOT

from mitsuba_ref.__main__ import main
from mitsuba_ref.cli import pages

DOCS = ROOT / "docs"


def test_every_page_is_in_the_wheel():
    data = PYPROJECT["tool"]["setuptools"]["package-data"]
    packed = {path.resolve() for pattern in data["mitsuba_ref"] for path in (ROOT / "mitsuba_ref").glob(pattern)}
    assert packed >= set(DOCS.rglob("*.md"))


@pytest.mark.parametrize("name", ["", "candidates", "candidates.md", "internals/jit", "jit"])
def test_what_is_not_a_terminal_gets_the_page_as_it_is(name, capsys):
    assert main(["docs", *name.split()]) == 0
    path = {"": "README.md", "candidates": "candidates.md", "candidates.md": "candidates.md"}
    assert capsys.readouterr().out == (DOCS / path.get(name, "internals/jit.md")).read_text()


def test_a_terminal_gets_it_formatted(monkeypatch, capsys):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "60")
    monkeypatch.setenv("NO_COLOR", "1")
    assert main(["docs", "concepts"]) == 0
    formatted = capsys.readouterr().out
    text = re.sub(r"\x1b\[[\d;]*m", "", formatted)
    assert "##" not in text and "**ours**" not in text and "From a difference to a class" in text
    assert max(map(len, text.splitlines())) == 60 and text != formatted


def test_a_misspelt_page_is_suggested_and_the_list_is_named(capsys):
    assert main(["docs", "candidate"]) == 2
    expected = "there is no page 'candidate' (mitsuba-ref docs lists all), did you mean 'candidates'?"
    assert expected in capsys.readouterr().err


def test_a_browser_gets_the_page_of_the_site_once_it_is_built(tmp_path, monkeypatch, capsys):
    opened = []
    monkeypatch.setattr(pages, "SITE", tmp_path)
    monkeypatch.setattr(pages.webbrowser, "open", opened.append)
    assert main(["docs", "jit", "--html"]) == 4
    assert "internals/jit.html: not found: in a clone, `make site`" in capsys.readouterr().err and not opened
    for name in ("internals/jit.html", "index.html"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert main(["docs", "jit", "--html"]) == main(["docs", "--html"]) == 0
    assert opened == [(tmp_path / name).as_uri() for name in ("internals/jit.html", "index.html")]

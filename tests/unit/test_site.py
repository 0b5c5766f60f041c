"""The site of `make site`, without MkDocs: its pages, its map and a page for each command."""

import re

import build_site
import pytest
from places import ROOT

import caster
import mitsuba_ref


@pytest.fixture
def site(tmp_path, monkeypatch):
    """docs/build_site.py, which writes into a folder of the test."""
    monkeypatch.setattr(build_site, "PAGES", tmp_path / "pages")
    return build_site


def test_the_map_of_the_site_has_every_page_and_every_command(site):
    site.copy_pages()
    names = site.write_command_pages(site.PAGES / "commands")
    named = re.findall(r"- (?:[\w ]+: )?(\S+\.md)$", site.configuration(names), re.MULTILINE)
    assert sorted(named) == sorted(page.relative_to(site.PAGES).as_posix() for page in site.PAGES.rglob("*.md"))
    assert {f"{program}-{name}" for program in site.PROGRAMS for name in site.parsers_of(program)} == {*names}


def test_a_file_outside_of_docs_is_brought_along_and_a_folder_is_an_error(site):
    site.copy_pages()
    page = site.PAGES / "candidates.md"
    target = site.within("../mitsuba_ref/starters/c/mine.c", page)
    assert (page.parent / target).read_bytes() == (ROOT / "mitsuba_ref/starters/c/mine.c").read_bytes()
    assert site.within("method.md", page) == "method.md"
    for link in ("candidates", "../README.md"):
        with pytest.raises(ValueError, match=f"candidates.md: {link}: expected a file, or a page of docs/"):
            site.within(link, page)


def test_the_page_of_a_command_has_every_option(site, tmp_path):
    site.write_command_pages(tmp_path / "commands")
    for program in site.PROGRAMS:
        for name, parser in site.parsers_of(program).items():
            page = (tmp_path / f"commands/{program}-{name}.md").read_text()
            missing = [each for action in parser._actions for each in action.option_strings if f" {each}" not in page]
            assert not missing, f"{program} {name}"


def test_the_api_page_of_the_site_has_a_directive_for_each_public_name(site):
    text = site.api.reference()
    for package, names in (("caster", caster.__all__), ("mitsuba_ref", mitsuba_ref.__all__)):
        missing = [name for name in names if f"{package}.{name}\n" not in text and not name.startswith("_")]
        assert not missing, package
    assert "- `Vec3`: 3 numbers\n" in text and "::: caster.rendering.hits.cast\n" in text

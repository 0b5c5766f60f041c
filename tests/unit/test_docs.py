"""Links and named places in docs/ and the README exist, and generated pages are up to date."""

import ast
import re
from pathlib import Path

import api
from places import ROOT

PAGES = sorted([*ROOT.glob("docs/**/*.md"), ROOT / "README.md"])
LINK = re.compile(r"\]\(([^)#\s]+)(#[^)\s]*)?\)")


# A file or folder of the tree, or a definition in a file after a colon.
PLACE = re.compile(r"`((?:benchmarks|caster|docs|mitsuba_ref|scenes|tests)/[\w/.-]*\w(?:/|:[\w.]+)?)`")
# To be filled in; attributes of EXR files; a folder of wheels.
NO_PLACES = re.compile(r"[A-Z]{4}|caster/(?:classes|faces_never_hit|jit/object_code)")


RECORDS = {"mutants.md"}  # places of the tree that was measured


def prose_of(page: Path) -> str:
    return re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)


def links_of(page: Path) -> list[str]:
    return [target for target, _ in LINK.findall(prose_of(page)) if "://" not in target]


def exists(place: str) -> bool:
    path, _, name = place.partition(":")
    if not (ROOT / path).exists():
        return False
    body = ast.parse((ROOT / path).read_text(encoding="utf-8")).body if name else []
    for part in name.split(".") if name else []:
        found = [each for each in body if getattr(each, "name", None) == part]
        if not found:
            return False
        body = found[0].body
    return True


def test_every_link_and_every_named_place_exists():
    gone, count = [], 0
    for page in PAGES:
        places = {place for place in PLACE.findall(prose_of(page)) if not NO_PLACES.search(place)}
        gone += [f"{page.name}: {target}" for target in links_of(page) if not (page.parent / target).exists()]
        gone += [f"{page.name}: {place}" for place in sorted(places) if page.name not in RECORDS and not exists(place)]
        count += len(places)
    assert not gone and count > 100
    assert not exists("caster/gone.py") and not exists("caster/scene/model.py:gone")


def test_the_map_names_every_page_and_at_most_twelve_for_users():
    index = ROOT / "docs/README.md"
    there = {page.relative_to(index.parent).as_posix() for page in ROOT.glob("docs/**/*.md")} - {"README.md"}
    assert {link for link in links_of(index) if link.endswith(".md")} == there
    assert len([page for page in there if "/" not in page]) <= 12


def test_the_code_of_a_recipe_is_that_of_the_example_of_the_same_name():
    folder, shown = ROOT / "benchmarks/scoreboard/casters", {}
    for page in ROOT.glob("docs/recipes/*.md"):
        shown |= re.findall(r"^```\w+\n// (\S+)\n(.*?)^```$", page.read_text(), re.DOTALL | re.MULTILINE)
    assert shown == {name: (folder / name).read_text() for name in ("embree.c", "three.mjs")}


def test_the_api_page_is_what_the_docstrings_say():
    written = (ROOT / "docs/api.md").read_text(encoding="utf-8")
    assert written == api.page(), "run python docs/api.py"

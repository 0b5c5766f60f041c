"""Words of this project's former private vocabulary do not come back; docs/glossary.md has the terms that are used."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SEARCHED = ("*.py", "*.md", "*.toml", "*.js", "Makefile")
HISTORY = {"CHANGELOG.md", "tests/unit/test_terms.py"}  # what was called so, and this list

# pattern -> the term of the field
REPLACED = {
    r"class-room": "classroom",
    r"whole_files?": "atomic_files",
    r"_?project_ball": "project_bounding_sphere",
    r"pictures? of (?:balls?|primitives?)": "screen bounds",
    r"straight lines straight": "rectilinear",
    r"bent_spans?": "wide-angle screen bounds",
    r"drawers?": "depth buckets",
    r"outlook": "ray bounds of a tile",
    r"in_turns|in_bands": "parallel_for",
    r"worked off": "processed",
    r"look_along|view_along": "trace, cast",
    r"work space": "workspace",
    r"turned_back": "transposed_mat_vec",
    r"Sketch": "UncertainHits",
    r"Meetings?": "Intersections",
    r"twofold": "double-double",
    r"Told": "on_progress",
    r"Saying|Heard": "request, response",
    r"Mitsuba said": "Mitsuba's captured stderr",
    r"(?:ask|asks|asking) for trouble": "adversarial",
    r"worth asking": "needs adjudication",
    r"ours_wrong": "wrong",
    r"MOST|FEWEST|MANY|ROOM": "a constant that names what it limits, and its unit",
    r"tells(?!:)|knows": "a description of the operation: code neither tells nor knows",
    r"terminal_line|progress_bar\.py": "caster/system/terminal.py",
    r"made_of|on_trial|in_common": "composition, requested_candidate, common_traits",
}

# the same for what users read: the packages and the pages; a test may still have a ball for a sphere
REPLACED_IN_PRODUCT = {
    r"[Bb]alls?(?! arithmetic)": "sphere, bounding sphere",
    r"(?<!of the )(?<!around the )(?<!torus of )tubes?(?! =)(?! \+)(?! \*)": "cylinder; the tube of a torus is one",
    r"asks|hears|told|saying": "a description of the operation",
    r"bundles?": "ray packet",
    r"[Dd]rawers?|[Oo]utlook|[Pp]ainting": "depth buckets, ray bounds, rendering",
}
# the same for names of tests and of files
REPLACED_IN_NAMES = {
    r"told|tells|knows": "reported, states",
    r"balls?": "sphere",
    r"tubes?(?!_of)": "cylinder",
    r"pictures?": "image, plot",
    r"bundles?": "packet",
    r"asks|asked": "requests, requested",
    r"meets?|met": "hits, hit",
    r"door|worker_of": "the interface that is meant",
    r"nobody|everybody|whoever": "none, all",
    r"bent": "distortion",
}
QUOTING = {"docs/faults.md"}  # names of planted faults and of shapes in scenes
PRODUCT = ("caster/", "mitsuba_ref/", "docs/", "README.md", "Makefile")


def files() -> list[str]:
    folders = [ROOT / name for name in ("caster", "mitsuba_ref", "benchmarks", "tests", "docs")]
    paths = [path for kind in SEARCHED for folder in folders for path in folder.rglob(kind)]
    paths += [path for kind in SEARCHED for path in ROOT.glob(kind)]
    return sorted({path.relative_to(ROOT).as_posix() for path in paths} - HISTORY)


def found(pattern: str, text: str) -> list[int]:
    """Numbers of the lines with a whole word or phrase; names are words joined by underscores."""
    word = re.compile(rf"(?<![^\W_])(?:{pattern})(?![^\W_])")
    return [number for number, line in enumerate(text.split("\n"), 1) if word.search(line)]


@pytest.fixture(scope="module")
def texts() -> dict[str, str]:
    return {name: (ROOT / name).read_text(encoding="utf-8") for name in files()}


@pytest.mark.parametrize("pattern", REPLACED)
def test_a_replaced_word_is_gone(texts, pattern):
    places = [f"{name}:{line}" for name, text in texts.items() for line in found(pattern, text)]
    assert not places, f"write '{REPLACED[pattern]}' at {', '.join(places)}"


@pytest.mark.parametrize("pattern", REPLACED_IN_PRODUCT)
def test_a_replaced_word_is_gone_from_what_users_read(texts, pattern):
    read = {name: text for name, text in texts.items() if name.startswith(PRODUCT) and name not in QUOTING}
    places = [f"{name}:{line}" for name, text in read.items() for line in found(pattern, text)]
    assert len(read) > 250 and not places, f"write '{REPLACED_IN_PRODUCT[pattern]}' at {', '.join(places)}"


@pytest.mark.parametrize("pattern", REPLACED_IN_NAMES)
def test_a_replaced_word_is_gone_from_names_of_files_and_tests(texts, pattern):
    tests = {
        f"{file}: {name}": name
        for file, text in texts.items()
        if file.startswith("tests/")
        for name in re.findall(r"^def (test_\w+)", text, re.MULTILINE)
    }
    names = tests | {name: Path(name).stem for name in texts if name.endswith(".py")}
    assert len(tests) > 1500
    places = [place for place, name in names.items() if found(pattern, name)]
    assert not places, f"write '{REPLACED_IN_NAMES[pattern]}' in {', '.join(places)}"


def test_a_word_that_comes_back_is_found():
    assert found(r"drawers?", "one\nsorted into drawers\nwithdrawers") == [2]
    assert found(r"Told", "told: Told | None") == [1] and len(files()) > 300
    assert found("ball", "def test_of_a_ball_the_far_root_is_found") == [1] and not found("ball", "ballistic")

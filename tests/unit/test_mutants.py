"""The mutation tool: its operators, and its score for a module with known mutants."""

import ast
from pathlib import Path

import pytest
from mutants.campaign import COMPILED_TESTS, END_TO_END, GROUPS, SMALL_AGREEMENT, SMALL_RAYS, TESTS, stale
from mutants.operators import keys_of, mutants_of
from mutants.page import page, score
from outputs import json_of
from places import ROOT
from programs import printed_by

MODULE = b'''"""Docstring 1 + 1."""
__all__ = ["largest"[0:7]]
UNUSED: "int | None" = None


def largest(a, b):
    """The larger one: 2 of 2."""
    if a > b:
        return a
    return b


def unused(a):
    raise ValueError("never", 1 + a)
'''
# By hand: > of largest gives >= (equal to it) and <=; the condition gives True, False and its negation; each
# return gives None. `raise` of a function that no test calls vanishes.
KILLABLE = {"(a <= b)", "(not (a > b))", "True", "False", "None"}
EQUIVALENT = {"(a >= b)"}
ASSERTING = """
from caster.module import largest


def test_largest():
    assert (largest(1, 2), largest(2, 1), largest(3, 3)) == (2, 2, 3)
"""
EMPTY = ASSERTING.replace("assert (largest(1, 2), largest(2, 1), largest(3, 3)) == (2, 2, 3)", "largest(1, 2)")


def test_each_operator_makes_its_edits_and_no_others():
    made = [(mutant.operator, mutant.new) for mutant in mutants_of(MODULE)]
    assert made.count(("returned early", "None")) == 2 and made.count(("dropped statement", "pass")) == 1
    assert {new for _, new in made} == KILLABLE | EQUIVALENT | {"pass"} and len(made) == 8


@pytest.mark.parametrize(
    ("source", "edits"),
    [
        ("x = a[0] - b", {"(a[0] + b)", "(a[0])", "b", "(1)", "(-1)"}),
        ("x = -a * f(b, c)", {"(-a / f(b, c))", "(-a)", "(f(b, c))", "a", "(f(c, b))"}),
        ("x = a and not b", {"(a or not b)", "(not b)", "a", "b"}),
        ("x = max(a, 0.5)", {"(min(a, 0.5))", "(0.25)"}),
        ("x: float | None = 1.0", {"(0.5)"}),
        ("x[0] = 2", {"pass", "(1)", "(-1)", "(3)"}),
        ("f(a)", {"pass"}),
        ("LOG.debug(1 + 2)", set()),
        ("assert a, 1 + 2", set()),
        ("x = 'a' + b", set()),
    ],
)
def test_edits_of_an_expression(source, edits):
    assert {mutant.new for mutant in mutants_of(source.encode())} == edits


def test_every_mutant_of_a_module_parses_and_differs_and_has_a_key_of_its_own():
    source = (ROOT / "caster/kernels/raster/tile_casting.py").read_bytes()
    found = mutants_of(source)
    assert len(found) > 500 and len(set(keys_of(source, found))) == len(found)
    before = ast.dump(ast.parse(source))
    assert all(ast.dump(ast.parse(mutant.applied(source))) != before for mutant in found[::20])


BROKEN = "import nothing_of_this_name\n"

# In a process of its own, which has loaded neither package.
CAMPAIGN = """
import json, pathlib, sys
from mutants.campaign import Settings, run
sources = {"planted": ("caster/module.py",)}
for name in sys.argv[1:]:
    tree = pathlib.Path(name)
    out, options = tree.with_name(tree.name + "-out"), {"sources": sources, "tests": ("test_*.py",)}
    settings = Settings(out, ("planted",), sample=0, jobs=1, root=tree, **options)
    try:
        run(settings)
    except RuntimeError as error:
        (tree / "error").write_text(str(error))
"""


# Each mutant that a campaign plants is a process of pytest: some thirty of them.
campaigns = pytest.mark.slow("a test of tests: plants mutants in three trees")


@pytest.fixture(scope="module")
def trees(tmp_path_factory) -> dict[str, Path]:
    """Folders of finished campaigns over MODULE, each with other tests."""
    found = {}
    for name, tests in {"asserting": ASSERTING, "empty": EMPTY, "broken": BROKEN}.items():
        tree = found[name] = tmp_path_factory.mktemp(name)
        for package in ("caster", "mitsuba_ref"):
            (tree / package).mkdir()
            (tree / package / "__init__.py").write_text("")
        (tree / "caster/module.py").write_bytes(MODULE)
        (tree / "test_module.py").write_text(tests)
    printed_by(
        "-P", "-c", CAMPAIGN, *found.values(), PYTHONPATH=f"{ROOT}/benchmarks:{ROOT}/tests/reference:{ROOT}/tests"
    )
    return found


def result_in(tree: Path) -> dict:
    return json_of(tree.with_name(f"{tree.name}-out") / "campaign.json")


@campaigns
def test_the_score_of_planted_mutants_is_exact(trees):
    result = result_in(trees["asserting"])
    survivors = {row["new"]: row["status"] for row in result["outcomes"] if row["status"] != "killed"}
    assert survivors == {"(a >= b)": "survived", "pass": "not executed"}
    known = {row["key"]: "both are the same number" for row in result["outcomes"] if row["new"] in EQUIVALENT}
    found = score(result["outcomes"], known)
    assert (found["run"], found["killed"], found["equivalent"], found["survived"]) == (8, 6, 1, 1)
    text = page(result, known)
    assert "| planted | 8 | 8 | 6 | 0 | 1 | 1 | 85.7% |" in text and "equivalent: both are the same" in text


@campaigns
def test_tests_that_assert_nothing_find_nothing(trees):
    outcomes = result_in(trees["empty"])["outcomes"]
    assert len(outcomes) == 8 and score(outcomes, {})["score"] == 0.0


@campaigns
def test_a_file_whose_tests_cannot_be_collected_ends_the_campaign(trees):
    assert "cannot be collected" in (trees["broken"] / "error").read_text()


def test_every_listed_test_is_there():
    """A name that is gone would leave its tests out in silence."""
    listed = {*TESTS, *COMPILED_TESTS, END_TO_END, SMALL_AGREEMENT, SMALL_RAYS}
    assert not [name for name in listed if not (ROOT / name).is_file()]
    assert all(list(ROOT.glob(pattern)) for patterns in GROUPS.values() for pattern in patterns)


def test_what_mutants_are_held_against_beside_the_tests_can_be_collected():
    files = [str(ROOT / name) for name in (END_TO_END, SMALL_AGREEMENT, SMALL_RAYS)]
    found = printed_by("-P", "-m", "pytest", "-q", "--collect-only", *files)
    assert all(f"{Path(name).name}::" in found for name in files)


def test_mitsuba_answers_the_second_run_of_a_test_from_the_folder(tmp_path):
    """A stored answer that cannot be read would kill every mutant of the judge."""
    test = f"{END_TO_END}::test_validate_passes[one-sphere]"
    paths = f"{ROOT}:{ROOT}/benchmarks"
    for _ in range(2):
        words = ("-P", "-m", "pytest", "-q", "-p", "mutants.measuring", test)
        printed_by(*words, PYTHONPATH=paths, MUTANTS_MEMORY=str(tmp_path))
        assert len(list(tmp_path.iterdir())) == 1


def test_equivalent_mutants_whose_lines_have_changed_are_found(tmp_path):
    (tmp_path / "module.py").write_bytes(MODULE)
    keys = [f"module.py {key}" for key in keys_of(MODULE, mutants_of(MODULE))]
    gone = ["module.py 0123456789ab", "gone.py 0123456789ab"]
    assert stale(dict.fromkeys([*keys, *gone], "a reason"), tmp_path) == gone

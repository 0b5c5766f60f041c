"""What the mark `slow` leaves out of `make test`, and that each mark says why."""

from pathlib import Path

import pytest

pytest_plugins = "pytester"
TESTS = Path(__file__).resolve().parents[1]
CONFTEST = (TESTS / "conftest.py").read_text(encoding="utf-8")
FILE = """
import os
import pytest

PICKED = os.environ["PICKED"]

@pytest.mark.parametrize("case", range(5))
@pytest.mark.slow("each waits", keep=2)
def test_cases(case):
    assert case < 2 or PICKED == "slow"

@pytest.mark.slow("waits")
def test_alone():
    pass

@pytest.mark.parametrize("case", range(7))
@pytest.mark.slow("each waits", every=3)
def test_every_third(case):
    assert case not in (1, 2, 4, 5) or PICKED == "slow"

def test_quick():
    pass
"""


@pytest.fixture
def run(pytester, monkeypatch):
    """Outcomes of pytest with the tree's own conftest.py."""
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.setenv("PYTHONPATH", str(TESTS.parent))
    pytester.makeconftest(CONFTEST)
    pytester.makepyfile(FILE)

    def picked(expression):
        monkeypatch.setenv("PICKED", expression)
        return pytester.runpytest_subprocess("-p", "no:cacheprovider", "-m", expression)

    return picked


@pytest.mark.slow("a test of tests: runs pytest twice")
def test_first_and_every_third_cases_are_kept_and_the_two_halves_are_everything(run):
    run("not slow").assert_outcomes(passed=2 + 3 + 1, deselected=3 + 4 + 1)
    run("slow").assert_outcomes(passed=3 + 4 + 1, deselected=2 + 3 + 1)


def test_a_mark_without_a_reason_is_an_error(run, pytester):
    pytester.makepyfile(test_bare="import pytest\n\n@pytest.mark.slow\ndef test_a():\n    pass\n")
    assert run("not slow").ret != 0


def test_continuous_integration_runs_both_halves():
    lines = (TESTS.parent / ".ci/run").read_text(encoding="utf-8").splitlines()
    assert {"make test", "make slow", "make faults"} <= set(lines)
    makefile = (TESTS.parent / "Makefile").read_text(encoding="utf-8")
    assert "-m 'not slow' $(ARGS)" in makefile and "-m slow $(ARGS)" in makefile

"""Continuous integration runs what the mark `slow` leaves out of `make test`."""

from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]


def test_continuous_integration_runs_both_halves():
    lines = (TESTS.parent / ".ci/run").read_text(encoding="utf-8").splitlines()
    assert "FAULTS=all make test ARGS='-m \"\"'" in lines  # the last -m counts
    makefile = (TESTS.parent / "Makefile").read_text(encoding="utf-8")
    assert "-m 'not slow' $(ARGS)" in makefile and "-m slow $(ARGS)" in makefile

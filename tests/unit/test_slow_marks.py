"""Continuous integration runs what the mark `slow` leaves out of `make test`."""

from places import ROOT


def test_continuous_integration_runs_both_halves():
    lines = (ROOT / ".ci/run").read_text(encoding="utf-8").splitlines()
    assert "FAULTS=all make test ARGS='-m \"\"'" in lines  # the last -m counts
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert "-m 'not slow' $(ARGS)" in makefile and "-m slow $(ARGS)" in makefile

"""Faults planted in a copy of the caster, one at a time: `mitsuba-ref fuzz` finds each, and nothing without one.

All of them by `make faults` (FAULTS=all); without it only those in QUICK.
"""

import functools
import json
import os
import tempfile
from pathlib import Path

import pytest
from edited_tree import ROOT, copy_tree, edit, run
from intersection_faults import FAULTS

from mitsuba_ref.fuzz.families import BY_NAME
from mitsuba_ref.fuzz.findings import FINDING_KINDS

QUICK = ("tangents excluded", "tubes without a far wall")
CHOSEN = [each for each in FAULTS if each.what in QUICK or os.environ.get("FAULTS") == "all"]


def kinds_found(tree: Path, family: str, examples: int) -> set[str]:
    """What the copy's fuzzer finds in its own caster, in plain Python."""
    with tempfile.TemporaryDirectory() as folder:
        told = Path(folder, "told.json")
        words = ["--family", family, "--examples", str(examples), "--keep", "0", "--judge-every", "0"]
        ended = run(tree, "fuzz", *words, "--out", folder, "--json", str(told))
        assert told.exists(), ended.stderr
        total = json.loads(told.read_text())["total"]
    assert total["examples"] == examples and total["rays"] >= 40 * examples
    assert ended.returncode == (1 if total["kinds"] else 0), ended.stderr
    return set(total["kinds"])


@functools.cache
def found_without_a_fault(family: str, examples: int) -> set[str]:
    with tempfile.TemporaryDirectory() as folder:
        return kinds_found(copy_tree(Path(folder)), family, examples)


@pytest.mark.parametrize("fault", CHOSEN, ids=lambda fault: fault.what.replace(" ", "-"))
@pytest.mark.slow("each is fuzzed in plain Python", keep=1)
def test_a_planted_fault_is_found(fault, tmp_path):
    """Caught by fuzz; an unedited copy passes the same examples."""
    tree = copy_tree(tmp_path)
    for each in fault.edits:
        edit(tree, *each)
    found = kinds_found(tree, fault.family, fault.examples)
    print(f"{fault.what}: caught by fuzz as {', '.join(sorted(found)) or 'nothing'}")
    assert found & fault.kinds, f"fuzz --family {fault.family} did not notice: {fault.what}"
    assert found_without_a_fault(fault.family, fault.examples) == set()


def test_a_known_defect_is_recognised_by_its_measurements():
    assert len(FAULTS) >= 20 and len({fault.what for fault in FAULTS}) == len(FAULTS)
    assert set(QUICK) <= {fault.what for fault in FAULTS}
    for fault in FAULTS:
        assert fault.edits and fault.kinds and fault.kinds <= set(FINDING_KINDS) and fault.family in BY_NAME


def test_every_edit_fits_the_source_of_today():
    """All of them, also those that only `make faults` runs."""
    for fault in FAULTS:
        for each in fault.edits:
            count = (ROOT / each.file).read_text(encoding="utf-8").count(each.old)
            assert count == 1, f"{fault.what}: {each.file} has {count} times: {each.old!r}"

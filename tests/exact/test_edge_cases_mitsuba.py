"""What Mitsuba does with the edge cases, against what it did, as far as that is the same on every CPU.

`python tests/exact/edge_cases.py` measures it anew and writes mitsuba_behaviour.json and docs/edge-cases.md.
"""

import pytest
from cases import CASES, behaviour
from cases.probes import PROBES

from mitsuba_ref.reference.variants import usable_variants

# Cases of every kind of shape, few enough to take seconds; each held with SSE4.2, AVX2 and AVX-512.
SAMPLE = (4, 5, 13, 16, 24, 27, 28, 30, 45, 56)


def test_the_data_reports_of_every_case_that_mitsuba_can_be_requested():
    kept = behaviour.kept()["cases"]
    askable = {str(case.number) for case in CASES if behaviour.questions(case) or case.number in PROBES}
    assert set(kept) == askable and len(askable) > 70
    for number, variants in kept.items():
        asked = [name for name in variants if not name.endswith("probes")]
        assert asked in ([], [f"{variant} {mode}" for variant in ("scalar", "llvm") for mode in behaviour.MODES]), (
            number
        )
        assert all(variants[name]["rays"] > 0 for name in asked)
        probed = set(variants) - set(asked)
        assert probed == ({"scalar probes", "llvm probes"} if int(number) in PROBES else set()), number


@pytest.mark.slow("asks Mitsuba about every edge case in every variant: it changes with Mitsuba, not with this tree")
def test_mitsuba_does_what_it_did():
    assert usable_variants().names, f"no variant of Mitsuba works here: {usable_variants().why}"
    now = behaviour.measured([case for case in CASES if case.number in SAMPLE], with_probes=False)
    assert set(now) == set(map(str, SAMPLE))
    assert [*behaviour.differences(now, behaviour.kept()["cases"])] == []


COUNTS = {"rays": 20, "missed": 2, "invented": 0, "no number": 0, "worst t": 1.5}


@pytest.mark.parametrize(
    ("mode", "now", "differs"),
    [
        ("robust", {"missed": 7, "worst t": 2.9}, False),
        ("robust", {"missed": 0}, True),
        ("robust", {"invented": 1}, True),
        ("robust", {"worst t": 4.1}, True),
        ("robust", {"no number": 1}, True),
        ("robust", {"rays": 19}, True),
        ("robust", {"refused": 3}, True),
        ("default", {"missed": 0, "worst t": 9.0}, False),
        ("default", {"invented": 1}, True),
    ],
)
def test_only_what_differs_between_cpus_may_differ(mode, now, differs):
    before = {"4": {f"scalar {mode}": COUNTS}}
    told = [*behaviour.differences({"4": {f"scalar {mode}": COUNTS | now}}, before)]
    assert len(told) == differs and all(text.startswith(f"case 4, scalar {mode}: now") for text in told)
    assert "kept None" in next(behaviour.differences(before, {}))

"""What Mitsuba does with the edge cases, against what it did: told, not asserted, since it is no part of ours.

`python tests/exact/edge_cases.py` measures it anew and writes mitsuba_behaviour.json and docs/edge-cases.md.
"""

import warnings

import pytest
from cases import CASES, behaviour
from cases.probes import PROBES

from mitsuba_ref.reference.variants import usable_variants

# Cases of every kind of shape, few enough to take seconds.
SAMPLE = (4, 5, 13, 16, 24, 27, 28, 30, 45, 56)


class MitsubaDiffers(UserWarning):
    """Mitsuba does something else than was measured: another version of it, or another machine."""


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


@pytest.mark.filterwarnings("default::test_edge_cases_mitsuba.MitsubaDiffers")
@pytest.mark.slow("asks Mitsuba about every edge case in every variant: it changes with Mitsuba, not with this tree")
def test_mitsuba_does_what_it_did():
    """What differs is a warning of the run."""
    assert usable_variants().names, f"no variant of Mitsuba works here: {usable_variants().why}"
    now = behaviour.measured([case for case in CASES if case.number in SAMPLE], with_probes=False)
    assert set(now) == set(map(str, SAMPLE))
    for text in behaviour.differences(now, behaviour.kept()["cases"]):
        warnings.warn(text, MitsubaDiffers, stacklevel=1)


def test_what_differs_is_reported():
    before = {"4": {"scalar robust": {"rays": 2, "missed": 0}}}
    now = {"4": {"scalar robust": {"rays": 2, "missed": 1}, "llvm robust": {"rays": 2, "missed": 0}}}
    assert [*behaviour.differences(before, before)] == []
    told = [*behaviour.differences(now, before)]
    assert len(told) == 2 and "case 4, scalar robust: now" in told[0] and "kept None" in told[1]

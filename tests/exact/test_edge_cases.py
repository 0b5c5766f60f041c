"""Edge cases, the caster against exact arithmetic: docs/edge-cases.md lists them, cases/ makes their rays.

EDGE_CASE_RAYS=20 asks twenty times as many rays.
"""

from collections import Counter

import pytest
from cases import CASES
from cases.case import PRECISIONS, Case, Maker, Precision
from cases.judging import SHOWN, judged, short_of

CHECKED = [(case, name) for case in CASES for name in case.checks or {}]


def label(value: object) -> str:
    return f"{value.number:02d}" if isinstance(value, Case) else str(getattr(value, "name", value))


@pytest.mark.parametrize("precision", PRECISIONS, ids=label)
@pytest.mark.parametrize("case", CASES, ids=label)
def test_ours_is_the_exact_answer(case: Case, precision: Precision):
    """Hit or miss, which primitive, t within its bounds, the normal."""
    wrong, short, met = [], [], Counter()
    for question in case.questions(Maker(case.number, precision)):
        found = judged(question)
        wrong += found.wrong
        short += short_of(question, found.met)
        met += found.met
    shown = "\n".join(wrong[:SHOWN])
    assert not wrong, f"case {case.number}, {case.name}: {len(wrong)} of {met['rays']} rays\n{shown}"
    assert not short, f"case {case.number}, {case.name}, did not meet what it is about\n" + "\n".join(short)
    assert met["rays"] == met["hit"] + met["miss"] > 0


@pytest.mark.parametrize(("case", "name"), CHECKED, ids=label)
def test_answers_that_have_to_be_alike_are(case: Case, name: str):
    assert case.checks is not None
    assert case.checks[name]() > 0

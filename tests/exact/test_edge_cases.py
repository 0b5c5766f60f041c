"""The caster against exact arithmetic in the edge cases of docs/internals/edge-cases.md, whose rays are made in cases/.

EDGE_CASE_RAYS=20 asks twenty times as many rays.
"""

from collections import Counter

import numpy as np
import pytest
from cases import CASES
from cases.case import FLOAT64, PRECISIONS, Case, Maker, Precision
from cases.judging import SHOWN, judged, short_of
from cases.shapes import KINDS, shape_of

from caster.shapes import SHAPES


def label(value: object) -> str:
    return f"{value.number:02d}" if isinstance(value, Case) else str(getattr(value, "name", value))


@pytest.mark.parametrize("precision", PRECISIONS, ids=label)
@pytest.mark.parametrize("case", CASES, ids=label)
@pytest.mark.slow("each case once more, in float32 numbers", every=2)
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


def test_each_case_is_listed_once_and_some_are_asked_of_every_shape():
    assert len({case.number for case in CASES}) == len({case.name for case in CASES}) == len(CASES) >= 25
    registered = {shape.model_fields["type"].default for shape in SHAPES}
    assert {shape_of(kind, np.random.default_rng(0)).type for kind in KINDS} == registered
    spread = [case for case in CASES if case.every_shape]
    assert len(spread) >= 5
    for case in spread:
        asked = {shape.type for each in case.questions(Maker(case.number, FLOAT64)) for shape in each.scene.shapes}
        assert asked == registered, f"case {case.number} leaves out {registered - asked}"

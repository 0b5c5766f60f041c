"""The oracle's boxes in float64 never reject a primitive that a ray hits."""

import math

import numpy as np
import pytest
from oracle_aims import KINDS, SCALES, aim, packed

from mitsuba_ref.oracle.boxes import BoxTree
from mitsuba_ref.oracle.exact_numbers import integer_rays
from mitsuba_ref.oracle.oracle import BOX_MARGIN, Oracle

COUNT = 300


def lost(kind: str, scale: str, seed: int = 1) -> tuple[int, int, int]:
    """(pairs that meet and are sorted out, or met before `near`; pairs that meet; pairs that are sorted out)."""
    prims, o, d = aim(kind, scale, seed, COUNT)
    (part,) = Oracle(packed(prims)).parts
    kept, near = np.zeros(COUNT, bool), np.full(COUNT, math.inf)
    for found in BoxTree(*part.kind.boxes(prims), BOX_MARGIN).crossings(o, d, -math.inf):
        own = found.ray == found.box
        kept[found.ray[own]], near[found.ray[own]] = True, found.near[own]
    wrong = meeting = 0
    for i, ray in enumerate(integer_rays(o, d)):
        first = [t for t, _ in part.intersect(i, ray)]
        meeting += bool(first)
        wrong += any(not kept[i] or t < near[i] for t in first)
    return wrong, meeting, int(COUNT - kept.sum())


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_sorted_out_is_not_hit(kind):
    totals = np.zeros(3, int)
    for scale in SCALES:
        found = lost(kind, scale)
        assert found[0] == 0, scale
        totals += found
    assert totals[1] >= 500 and (totals[2] >= 15 or kind == "Planes"), totals

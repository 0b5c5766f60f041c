"""The oracle agrees with textbook Fractions and ball arithmetic for each kind of primitive, one ray at a time."""

import math
from collections import Counter
from fractions import Fraction

import numpy as np
import oracle_fractions
import pytest
from oracle_aims import KINDS, SCALES, aim, packed, root_bracket
from oracle_fractions import Solution

from mitsuba_ref.oracle.boxes import BoxTree
from mitsuba_ref.oracle.exact_numbers import Root, integer_rays
from mitsuba_ref.oracle.oracle import BOX_MARGIN, EXACT_KINDS, Oracle

COUNT = 120  # pairs of a kind and a scale
WHERE = {
    "Triangles": {"inside", "edge", "vertex"},
    "Planes": {"inside"},
    "Spheres": {"inside", "tangent"},
    "Ellipsoids": {"inside", "tangent"},
    "Cylinders": {"inside", "tangent", "rim"},
    "Disks": {"inside", "rim"},
    "OuterEllipsoids": {"inside", "tangent"},
    "RoundSegments": {"inside", "tangent"},
}


def same(found: Root, expected: Solution) -> bool:
    """Whether the expected root lies where the oracle's does, to 2^-200 of itself, between the floats around it."""
    low, high = root_bracket(found, 300)
    if expected.compare(low) < 0 or expected.compare(high) > 0 or high - low > abs(low) * Fraction(2) ** -200:
        return False
    near = float(found)
    around = [(math.nextafter(near, -math.inf), 1), (math.nextafter(near, math.inf), -1)]
    return all(expected.compare(Fraction(x)) == side for x, side in around if math.isfinite(x))


def agrees(found, expected) -> bool:
    return [where for _, where in found] == [where for _, where in expected] and all(
        same(t, solution) for (t, _), (solution, _) in zip(found, expected, strict=True)
    )


def disagreements(kind: str, scale: str, seen: Counter, seed: int = 1, count: int = COUNT) -> int:
    """Of `count` pairs, those where oracle and Fractions differ; counts what was met."""
    prims, o, d = aim(kind, scale, seed, count)
    (part,), wrong = Oracle(packed(prims)).parts, 0
    for i, ray in enumerate(integer_rays(o, d)):
        found, expected = part.intersect(i, ray), oracle_fractions.roots(prims, i, o[i], d[i])
        wrong += not agrees(found, expected)
        seen.update([where for _, where in expected] or ["miss"])
    return wrong


@pytest.mark.parametrize("kind", KINDS)
def test_every_root_is_that_of_textbook_fractions(kind):
    seen: Counter = Counter()
    for scale in SCALES:
        assert disagreements(kind, scale, seen) == 0, scale
    assert set(seen) == WHERE[kind] | {"miss"}
    assert min(seen.values()) >= 20, seen


def test_every_kind_that_shapes_pack_to_is_checked():
    assert {kind.__name__ for kind in EXACT_KINDS} == set(KINDS)


# ---- boxes in float64 never reject a primitive that a ray hits

RAYS = 300


def lost(kind: str, scale: str, seed: int = 1) -> tuple[int, int, int]:
    """(pairs that meet and are sorted out, or met before `near`; pairs that meet; pairs that are sorted out)."""
    prims, o, d = aim(kind, scale, seed, RAYS)
    (part,) = Oracle(packed(prims)).parts
    kept, near = np.zeros(RAYS, bool), np.full(RAYS, math.inf)
    for found in BoxTree(*part.kind.boxes(prims), BOX_MARGIN).crossings(o, d, -math.inf):
        own = found.ray == found.box
        kept[found.ray[own]], near[found.ray[own]] = True, found.near[own]
    wrong = meeting = 0
    for i, ray in enumerate(integer_rays(o, d)):
        first = [t for t, _ in part.intersect(i, ray)]
        meeting += bool(first)
        wrong += any(not kept[i] or t < near[i] for t in first)
    return wrong, meeting, int(RAYS - kept.sum())


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_sorted_out_is_not_hit(kind):
    totals = np.zeros(3, int)
    for scale in SCALES:
        found = lost(kind, scale)
        assert found[0] == 0, scale
        totals += found
    assert totals[1] >= 500 and (totals[2] >= 15 or kind == "Planes"), totals

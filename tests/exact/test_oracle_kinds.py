"""Each kind of primitive, one ray at a time: the oracle, textbook Fractions and ball arithmetic say the same."""

import math
from collections import Counter
from fractions import Fraction

import oracle_fractions
import pytest
from oracle_aims import KINDS, SCALES, aim, packed
from oracle_fractions import Solution

from mitsuba_ref.oracle import exact_numbers, exact_planar, exact_quadrics
from mitsuba_ref.oracle.exact_quadrics import to_object_space
from mitsuba_ref.oracle.oracle import EXACT_KINDS, Oracle, Root

COUNT = 120  # pairs of a kind and a scale
WHERE = {
    "Triangles": {"inside", "edge", "vertex"},
    "Planes": {"inside"},
    "Spheres": {"inside", "tangent"},
    "Ellipsoids": {"inside", "tangent"},
    "Cylinders": {"inside", "tangent", "rim"},
    "Disks": {"inside", "rim"},
}


def same(found: Root, expected: Solution) -> bool:
    """Whether the expected root lies where the oracle's does, to 2^-200 of itself, and both floats around it."""
    low, high = found.bracket(300)
    if expected.compare(low) < 0 or expected.compare(high) > 0 or high - low > abs(low) * Fraction(2) ** -200:
        return False
    below, above = found.interval()
    around = [(x, side) for x, side in ((below, 1), (above, -1)) if math.isfinite(x)]
    return all(expected.compare(Fraction(x)) in (0, side) for x, side in around)


def agrees(found, expected) -> bool:
    return [hit.where for hit in found] == [where for _, where in expected] and all(
        same(hit.t, solution) for hit, (solution, _) in zip(found, expected, strict=True)
    )


def disagreements(kind: str, scale: str, seen: Counter, seed: int = 1, count: int = COUNT) -> int:
    """Of `count` pairs, those where oracle and Fractions differ; counts what was met."""
    prims, o, d = aim(kind, scale, seed, count)
    oracle, wrong = Oracle(packed(prims)), 0
    for i in range(count):
        found, expected = oracle.roots(i, o[i], d[i]), oracle_fractions.roots(prims, i, o[i], d[i])
        wrong += not agrees(found, expected)
        seen.update([where for _, where in expected] or ["miss"])
    return wrong


@pytest.mark.parametrize("kind", KINDS)
def test_every_root_is_that_of_textbook_fractions(kind):
    seen: Counter = Counter()
    for scale in SCALES:
        assert disagreements(kind, scale, seen) == 0, scale
    print(kind, dict(seen))
    assert set(seen) == WHERE[kind] | {"miss"}
    assert min(seen.values()) >= 20, seen


def test_every_kind_that_shapes_pack_to_is_checked():
    assert {kind.__name__ for kind in EXACT_KINDS} == set(KINDS)


FAULTS = {
    "an edge function has the wrong sign": ("Triangles", exact_planar, "cross", lambda a, b: one_sign_off(a, b)),
    "the corners are not shifted alike": ("Triangles", exact_planar, "shifted", lambda v, bits: v),
    "the plane's height is not shifted": ("Planes", exact_planar, "shifted", lambda v, bits: v),
    "squares are compared without their signs": (
        "Cylinders",
        exact_quadrics,
        "sign_with_root",
        lambda a, b, r: exact_numbers.sign(a * a - b * b * r),
    ),
    "the height of a root leaves out its divisor": (
        "Cylinders",
        exact_quadrics,
        "height",
        lambda t, o, d: exact_numbers.sign_with_root(o + t.p * d, t.q * d, t.r),
    ),
    "a mirror image reverses the cylinder": ("Cylinders", exact_quadrics, "abs", lambda x: x),
    "the inverse is not transposed": (
        "Ellipsoids",
        exact_quadrics,
        "to_object_space",
        lambda by, ray: to_object_space(by._replace(adjugate=tuple(zip(*by.adjugate, strict=True))), ray),
    ),
    "both roots are the far one": ("Spheres", exact_quadrics, "Root", lambda p, q, r, s, e: Root(p, abs(q), r, s, e)),
    "the circle of a disk is open": ("Disks", exact_planar, "Root", lambda p, q, r, s, e: Root(p + 1, q, r, s, e)),
}


def one_sign_off(a, b):
    """a x b, but for one sign."""
    return a[1] * b[2] + a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_detected(fault, monkeypatch):
    kind, module, name, planted = FAULTS[fault]
    monkeypatch.setattr(module, name, planted, raising=False)
    assert sum(disagreements(kind, scale, Counter(), count=40) for scale in ("whole", "rounded", "tiny")) > 0

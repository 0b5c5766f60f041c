"""Numbers (p + q sqrt(r)) / s 2^e: their order, their floats and their distances, against ball arithmetic."""

import math
from fractions import Fraction
from itertools import pairwise, product

import numpy as np
from flint import arb, ctx, fmpq

from mitsuba_ref.oracle.exact_numbers import Root, sign_with_root, sign_with_roots

BITS = 4000  # the least distance of two unequal roots below is above 2^-2000


def ball(x: Root, bits: int = BITS) -> arb:
    ctx.prec = bits
    return (x.p + x.q * arb(x.r).sqrt()) / x.s * arb(2) ** x.e


def whole(rng, bits: int) -> int:
    """A whole number of up to `bits` bits, of either sign."""
    size = int(rng.integers(0, bits + 1))
    return int.from_bytes(rng.bytes(bits // 8 + 1), "little") % (1 << size) * int(rng.choice([-1, 1]))


def roots(rng, count: int, bits: int, reach: int) -> list[Root]:
    found = []
    for _ in range(count):
        p, q, r, s = (whole(rng, bits) for _ in range(4))
        found.append(Root(p, q, abs(r), s or 1, int(rng.integers(-reach, reach + 1))))
    return found


def neighbours(x: Root, rng) -> list[Root]:
    """The same number written differently, and others very near to it."""
    k = abs(whole(rng, 20)) + 1
    return [
        Root(x.p * k, x.q * k, x.r, x.s * k, x.e),
        Root(x.p, x.q, x.r, x.s * 4, x.e + 2),
        Root(x.p * k, x.q, x.r * k * k, x.s * k, x.e),
        Root(x.p, x.q, x.r + 1, x.s, x.e),
        Root(2 * x.p + 1, 2 * x.q, x.r, 2 * x.s, x.e),
        Root(x.p, -x.q, x.r, x.s, x.e),
        Root.of(Fraction(*float(x).as_integer_ratio())) if math.isfinite(float(x)) else x,
    ]


def sample(seed: int) -> list[tuple[Root, Root]]:
    rng = np.random.default_rng(seed)
    few = roots(rng, 25, 3, 2)
    near = [(x, y) for x in roots(rng, 60, 200, 300) + few for y in neighbours(x, rng)]
    return [*product(few, few), *near, *pairwise(roots(rng, 100, 100, 5))]


def order_of_balls(x: Root, y: Root) -> int:
    """Balls that overlap at 4000 bits belong to equal numbers."""
    one, other = ball(x), ball(y)
    return int(bool(one > other)) - int(bool(one < other))


def disorders(seed: int = 1) -> tuple[int, list[int]]:
    """(pairs that are ordered otherwise than their balls, how many are <, = and >)."""
    wrong, counts = 0, [0, 0, 0]
    for x, y in sample(seed):
        expected = order_of_balls(x, y)
        counts[expected + 1] += 1
        wrong += x.compare(y) != expected or y.compare(x) != -expected
        wrong += (x == y, x < y, x <= y, x > y, x >= y) != tuple(
            sign in signs for sign, signs in [(expected, s) for s in ((0,), (-1,), (-1, 0), (1,), (0, 1))]
        )
    return wrong, counts


def test_roots_are_ordered_as_their_balls():
    wrong, counts = disorders()
    assert wrong == 0
    assert min(counts) >= 200, counts


def test_the_sign_of_a_sum_that_is_zero_is_zero():
    assert sign_with_root(-6, 2, 9) == sign_with_root(6, -3, 4) == sign_with_root(0, 5, 0) == 0
    assert sign_with_roots(0, 3, 8, -6, 2) == sign_with_roots(-5, 1, 4, 1, 9) == sign_with_roots(1, 1, 4, -1, 9) == 0
    assert sign_with_roots(0, 0, 7, 0, 3) == 0
    # sqrt(2) + sqrt(3) against sqrt(5 + 2 sqrt 6) rounded down and up
    below = math.isqrt((5 << 200) + math.isqrt(24 << 400))
    assert sign_with_roots(-below, 1 << 100, 2, 1 << 100, 3) == 1
    assert sign_with_roots(-below - 1, 1 << 100, 2, 1 << 100, 3) == -1


def test_the_float_of_a_root_is_the_nearest():
    rng = np.random.default_rng(2)
    irrational = 0
    for x in roots(rng, 300, 120, 30) + roots(rng, 60, 200, 1100) + roots(rng, 100, 2, 1):
        near, exact = float(x), ball(x, 6000)
        irrational += math.isqrt(x.r) ** 2 != x.r
        if math.isinf(near):
            assert abs(exact) > arb(2) ** 1023
            continue
        for other in (math.nextafter(near, -math.inf), math.nextafter(near, math.inf)):
            if math.isfinite(other):
                assert not abs(exact - other) < abs(exact - near)
        assert math.copysign(1.0, near) == 1.0 or near < 0.0 or exact < 0
    assert irrational >= 200


def test_float_finds_what_nearly_cancels():
    """n + 1 - sqrt(n^2 + 2 n) is a little less than 1 / 2n, 600 bits below its terms; with one more, it is 0."""
    n = 1 << 300
    x = Root(n + 1, -1, n * n + 2 * n)
    assert float(x) == 2.0**-301 and x != 2.0**-301 and x < 2.0**-301
    assert float(Root(n + 1, -1, n * n + 2 * n + 1)) == 0.0
    assert math.copysign(1.0, float(Root(-1, 0, 0, 1, -2000))) == 1.0


def test_off_is_the_distance_and_0_only_where_it_is_0():
    rng = np.random.default_rng(3)
    for x in roots(rng, 300, 120, 30):
        for y in (float(x), math.nextafter(float(x), 0.0), 1.0, 0.0, -1e300, 5e-324):
            expected = abs(ball(x) - arb(fmpq(*y.as_integer_ratio())))
            off = x.off(y)
            assert (off == 0.0) == (x == y)
            if not 1e-300 < off < math.inf:
                continue
            assert abs(expected - off) <= expected * arb(2) ** -40
    tiny = Root(0, 1, 2, 1, -1100)
    assert tiny.off(0.0) == 5e-324 and Root.of(0.1).off(0.1) == 0.0
    assert Root(1).off(math.inf) == Root(1).off(-math.inf) == math.inf and math.isnan(Root(1).off(math.nan))

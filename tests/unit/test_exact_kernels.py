"""The exact arithmetic of kernels: integers against Python's, roots and their order against Fractions."""

import math
import sys
from fractions import Fraction

import numpy as np
import pytest
from triangle_soup import triangle_soup

from caster.kernels.exact import numbers as big
from caster.kernels.exact.numbers import AS_FLOAT_REL_ERROR, Root, as_float, compare, is_within, surd_of_float
from caster.kernels.math.vec import UNDECIDED
from caster.kernels.nearest import KeepFirst, first_of, hit_by_float64, no_hits, store_first
from caster.kernels.protocol import same_geometry

RNG = np.random.default_rng(70)


def value(x):
    return sum(int(digit) << (big.BITS * i) for i, digit in enumerate(x))


def some_floats(count):
    """Of all sizes, some whole, some denormal, some zero."""
    wide = RNG.normal(size=count) * 2.0 ** RNG.integers(-1074, 1000, count)
    near = RNG.integers(-9, 10, count) * 2.0 ** RNG.integers(-3, 4, count)
    return [*np.where(RNG.random(count) < 0.5, wide, near).tolist(), 5e-324, -5e-324, sys.float_info.max, 0.0]


def some_integers(count):
    """Of up to 40 digits of 2^26, and the borders where a carry begins."""
    found = [
        int(x) * (1 << int(k)) + int(y) for x, k, y in RNG.integers(-(2**40), 2**40, (count, 3)) % [2**41, 900, 2**41]
    ]
    for bits in (26, 52, 78, 26 * 5):
        found += [2**bits, 2**bits - 1, -(2**bits), 1 - 2**bits, -(2**bits) - 1]
    return [*found, 0, 1, -1]


def as_digits(x):
    """A Python integer as the kernels write it."""
    out = []
    while not -big.BASE <= x < big.BASE:
        out.append(x & big.MASK)
        x >>= big.BITS
    return np.array([*out, x], np.int64)


def is_in_form(x):
    """All digits but the last in [0, 2^26), the last in [-2^26, 2^26] and not a needless one."""
    assert all(0 <= digit < big.BASE for digit in x[:-1]) and -big.BASE <= x[-1] <= big.BASE
    assert len(x) == 1 or x[-1] not in (0, -1)


def test_a_float_is_the_integer_it_is():
    floats = some_floats(500)
    for group in zip(floats[0::2], floats[1::2], strict=False):
        e = big.lowest_exponent(group)
        for x in group:
            digits = big.integer(x, e)
            is_in_form(digits)
            assert Fraction(value(digits)) * Fraction(2) ** e == Fraction(x)


def test_sums_products_signs_and_shifts_are_those_of_python():
    ints = some_integers(60)
    for x in ints:
        a = as_digits(x)
        assert value(a) == x and big.sign(a) == (x > 0) - (x < 0)
        assert value(big.shifted(a, 77)) == x << 77 and value(big.signed(-1, a)) == -x
        for y in ints[::3]:
            b = as_digits(y)
            for got, expected in ((big.plus, x + y), (big.minus, x - y), (big.times, x * y)):
                digits = got(a, b)
                is_in_form(digits)
                assert value(digits) == expected


def test_a_product_of_more_digits_than_fit_without_a_carry():
    """2^26 - 1 in every digit, more of them than ROWS_PER_CARRY."""
    digits = 2 * big.ROWS_PER_CARRY + 3
    a = np.full(digits, big.MASK, np.int64)
    assert value(big.times(a, a)) == ((1 << (big.BITS * digits)) - 1) ** 2


def test_leading_is_within_two_roundings():
    for x in some_integers(300):
        f, e = big.leading(as_digits(x))
        exact = Fraction(f) * Fraction(2) ** e
        assert abs(exact - x) <= Fraction(2.0**-52) * abs(x)


def a_root(p, r, q, s, e):
    return Root(True, as_digits(p), as_digits(r), as_digits(q), s if r else 0, e)


def some_roots(count):
    """Roots, many of them equal or nearly so: (root, its value in 200 bits, an exact key)."""
    found = []
    for _ in range(count):
        p, r, q = (int(x) for x in RNG.integers(-6, 7, 3))
        r, q, s, e = abs(r), abs(q) + 1, int(RNG.integers(-1, 2)), int(RNG.integers(-3, 4))
        scale = int(RNG.integers(1, 2**40))  # the same number in larger integers
        found.append((a_root(p * scale, r * scale * scale, q * scale, s, e), (p, r if s else 0, q, s, e)))
    return found


def precisely(key):
    p, r, q, s, e = key
    bits = 400
    root = math.isqrt(r << (2 * bits))
    return (Fraction(p) + s * Fraction(root, 1 << bits)) / q * Fraction(2) ** e


def same(x, y):
    """Whether two keys are the same number: their difference times its conjugates is zero."""
    return abs(precisely(x) - precisely(y)) < Fraction(1, 1 << 300)  # unequal ones of this size are farther apart


def test_the_sign_of_a_surd_is_that_of_the_number():
    roots = {0: 0.0, 1: 1.0, 2: 2.0**0.5, 4: 2.0, 7: 7.0**0.5, 9: 3.0}
    for a in range(-4, 5):
        for b in range(-4, 5):
            for r, root in roots.items():
                number = a + b * root  # exactly 0 or far from it
                expected = (number > 1e-9) - (number < -1e-9)
                assert big.sign_of_surd(as_digits(a), as_digits(b), as_digits(r)) == expected, (a, b, r)


def test_roots_are_in_order():
    roots = some_roots(250)
    equal = 0
    for (x, a), (y, b) in zip(roots, roots[1:] + roots[:1], strict=True):
        expected = 0 if same(a, b) else (1 if precisely(a) > precisely(b) else -1)
        assert compare(x, y) == expected == -compare(y, x), (a, b)
        assert compare(x, x) == 0
    for x, a in roots[:60]:
        for y, b in roots[:60]:
            if same(a, b):
                equal += 1
                assert compare(x, y) == 0
    assert equal >= 70, "more pairs than each with itself"


def test_a_root_as_a_float_is_within_its_error():
    for x, key in some_roots(400):
        exact = precisely(key)
        got = Fraction(as_float(x))
        assert abs(got - exact) <= Fraction(AS_FLOAT_REL_ERROR) * abs(exact) + Fraction(1, 1 << 300), key


def test_limits_are_exact_and_closed_above():
    third = a_root(1, 0, 3, 0, 0)
    below, above = 1.0 / 3.0, math.nextafter(1.0 / 3.0, 1.0)  # 1/3 rounds down
    assert is_within(third, below, above) and not is_within(third, above, math.inf)
    assert not is_within(third, 0.0, below)
    assert is_within(surd_of_float(2.0), math.nextafter(2.0, 0.0), 2.0) and not is_within(
        surd_of_float(2.0), 2.0, math.inf
    )
    root2 = a_root(0, 2, 1, 1, 0)
    rounded = math.sqrt(2.0)  # rounded up
    assert is_within(root2, math.nextafter(rounded, 0.0), rounded) and not is_within(root2, rounded, math.inf)


@pytest.mark.parametrize("shift", [0, 900, -900])
def test_an_integer_too_large_for_a_float_gives_the_largest(shift):
    x = a_root(1 << 2000, 0, 1, 0, shift)
    assert as_float(x) == sys.float_info.max
    assert as_float(a_root(1, 0, 1 << 2000, 0, shift)) == (0.0 if shift <= 0 else 2.0 ** (shift - 2000))


def stacked_triangles():
    """Right angles at heights 2, 1, 3, 1, 1 above the origin; 1 and 3 are the same one, 4 is larger."""
    heights, sizes = [2.0, 1.0, 3.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0, 2.0]
    corners = np.array([[-1.0, -1.0, 0.0], [3.0, -1.0, 0.0], [-1.0, 3.0, 0.0]])
    vertices = np.concatenate([s * corners + [0.0, 0.0, h] for s, h in zip(sizes, heights, strict=True)])
    return triangle_soup(vertices), np.array(heights)


@pytest.mark.parametrize("decided", [True, False])
@pytest.mark.parametrize("t_min", [0.0, 0.25, 0.5, 0.75, 1.5])
def test_of_candidates_the_first_exactly_is_the_hit_and_on_a_tie_the_one_of_the_least_number(t_min, decided):
    """In any order, also of equal primitives, whether float64 is sure of their hits or not; |d| = 4."""
    prims, heights = stacked_triangles()
    rng = np.random.default_rng(240)
    for t_max in (math.inf, 0.5) * 40:
        ray, numbers = ((0.0, 0.0, 0.0), (0.0, 0.0, 4.0), t_min, t_max), rng.permutation(5)[: rng.integers(6)].tolist()
        first = -1
        for k in numbers:
            t, error = hit_by_float64(prims, k, ray) if decided else UNDECIDED
            if t < math.inf:
                first = first_of(prims, ray, k, error < math.inf, first)
        ahead = [k for k in numbers if t_min < heights[k] / 4.0 <= t_max]
        expected = min(ahead, key=lambda k: (heights[k], k), default=-1)
        found = no_hits(1)
        store_first(KeepFirst(ray, prims, math.inf), first, found, 0)
        assert first == found.prim[0] == expected
        assert found.t[0] == (heights[expected] / 4.0 if ahead else math.inf) and 0.0 <= found.error[0] < 1e-13


def test_geometry_is_the_same_where_all_of_its_numbers_are():
    prims, _ = stacked_triangles()
    same = [(k, j) for k in range(5) for j in range(5) if same_geometry(prims, k, j)]
    assert same == [(0, 0), (1, 1), (1, 3), (2, 2), (3, 1), (3, 3), (4, 4)]
    for vertex in range(3):
        for axis in range(3):
            kept = prims.vertices[9 + vertex, axis]
            prims.vertices[9 + vertex, axis] = math.nextafter(kept, 9.0)
            assert not same_geometry(prims, 1, 3) and not same_geometry(prims, 3, 1)
            prims.vertices[9 + vertex, axis] = kept

"""Normals of triangles that are nearly lines, against rational numbers."""

from fractions import Fraction

import numpy as np

from caster.kernels.math.vec import U, cross, permanent, sub
from caster.kernels.triangles import MIN_SIN_SQUARED, triangle_normal

SAMPLES = 300
FEW_U = 4 * U


def needle(rng: np.random.Generator, bits: int) -> np.ndarray:
    """Three corners in a line, but for 2^-bits of its length."""
    a, along = rng.normal(size=(2, 3))
    off = rng.normal(size=3) * 2.0**-bits
    return np.array([a, a + along, a + rng.uniform(0.2, 0.8) * along + off])


def exact_normal(corners: np.ndarray) -> tuple[Fraction, ...]:
    a, b, c = ([Fraction(x) for x in corner] for corner in corners.tolist())
    e, f = [y - x for x, y in zip(a, b, strict=True)], [y - x for x, y in zip(a, c, strict=True)]
    return e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]


def to_unit(v: tuple[Fraction, ...]) -> np.ndarray:
    largest = max(abs(x) for x in v)
    rounded = np.array([float(x / largest) for x in v])
    return rounded / np.linalg.norm(rounded)


def of(corners: np.ndarray) -> tuple:
    return tuple(tuple(float(x) for x in corner) for corner in corners)


def test_the_normal_of_a_needle_is_known_to_the_last_bits():
    rng = np.random.default_rng(70)
    lost = 0
    for bits in range(20, 54):
        for _ in range(SAMPLES // 30):
            corners = needle(rng, bits)
            exact = exact_normal(corners)
            if not any(exact):
                continue
            a, b, c = of(corners)
            e1, e2 = sub(b, a), sub(c, a)
            plain, spread = np.linalg.norm(cross(e1, e2)), np.linalg.norm(permanent(e1, e2))
            lost += plain <= 4 * U * spread
            half = plain**2 > MIN_SIN_SQUARED * spread**2
            known = 4 * U * (1 + 2 * spread / plain if half else 1)
            assert abs(np.array(triangle_normal(a, b, c)) - to_unit(exact)).max() <= known, (bits, corners)
    assert lost > SAMPLES // 30  # the textbook's cross product is nothing worth for many of them


def test_a_line_has_a_normal_across_it_and_a_point_has_none():
    for axis in np.vstack([np.eye(3), [[1.0, -2.0, 3.0], [1e-200, 3e-200, 0.0], [0.0, 1e15, -1e15]]]):
        a, b, c = of(np.array([0.0 * axis, 2.0 * axis, axis]))
        n = np.array(triangle_normal(a, b, c))
        assert abs(np.linalg.norm(n) - 1.0) <= FEW_U and abs(n @ axis) <= FEW_U * np.abs(axis).max()
    assert triangle_normal((1.0, 2.0, 3.0), (1.0, 2.0, 3.0), (1.0, 2.0, 3.0)) == (0.0, 0.0, 0.0)

"""`intersect` of every kind of primitive against decimals of 80 digits, on the very numbers that are cast."""

from decimal import Decimal
from typing import NamedTuple

import numpy as np
import pytest
from exact import Answer, answers, oracle
from hard_rays import around, picked, scene_points
from random_scenes import KINDS, MATERIALS, name, random_shape

from caster.cameras import Pinhole
from caster.geometry.packing import Packed, pack
from caster.geometry.world_space import as_given
from caster.rendering.casting import find_nearest
from caster.rendering.hits import validated_rays
from caster.scene.model import Scene
from caster.shapes import SHAPES, Sphere

OFFSETS = 2 * (0.0, 1.0, 1e3, 1e5, 1e7)
PAIRS = 1000  # of a ray and a primitive, for each offset
ULP = 2.0**-52
# Times the condition, which counts each operand's rounding once and not the roundings in between.
T_ULPS = 4.0
# Rays closer than that to an edge are left to tests/exact.
MARGIN = 16.0 * 2.0**-53


def compare(packed: Packed, o: np.ndarray, d: np.ndarray) -> tuple[int, int, float, int]:
    """(hits, misses, largest error of t in ulps times the condition, rays too close to an edge to tell)."""
    ours = find_nearest(packed, validated_rays(o, d, 0.0, np.inf), "brute-force")
    hits, misses, worst, close = 0, 0, 0.0, 0
    for i in range(len(o)):
        each = answers(packed.kinds[0].prims, o[i], d[i])
        met = [answer for answer in each if answer.t is not None]
        if min(answer.margin for answer in each) <= MARGIN:
            close += 1
        elif not met:
            assert ours.prim[i] < 0, f"ray {i}: t = {ours.t[i]!r}, but nothing is there"
            misses += 1
        else:
            first, ours_alone = min(met, key=lambda answer: answer.t), each[ours.prim[i]]
            assert ours.prim[i] >= 0, f"ray {i}: passes through t = {first.t}"
            assert ours_alone.t is not None, f"ray {i}: primitive {ours.prim[i]} is not met"
            error = max(error_in_ulps(ours.t[i], first), error_in_ulps(ours.t[i], ours_alone))
            hits, worst = hits + 1, max(worst, error)
    return hits, misses, worst, close


def error_in_ulps(t: float, answer: Answer) -> float:
    return float(abs(Decimal(float(t)) - answer.t) / answer.t) / ULP / answer.condition


def alone(shape) -> Packed:
    camera = Pinhole(eye=(9, 0, 0), look_at=(0, 0, 0))
    return pack(Scene(camera=camera, materials=MATERIALS, shapes=[shape]))


def rays_about(packed: Packed, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Rays of any length from near a shape at places of its primitives, and some past it."""
    points = scene_points(packed)
    count = min(max(PAIRS // len(points), 12), 150)
    o, ends = around(points, rng, count), picked(points, rng, count)
    aim = np.einsum("nj,njc->nc", rng.dirichlet(np.ones(3), count), ends)
    astray = rng.choice([0.0, 1.0], (count, 1)) * rng.normal(size=(count, 3))
    return o, (aim + astray - o) * 10.0 ** rng.uniform(-3.0, 3.0, (count, 1))


@pytest.mark.parametrize("shape", KINDS, ids=name)
def test_intersect_agrees_with_exact_arithmetic(shape):
    rng = np.random.default_rng([70, SHAPES.index(shape)])
    total, kinds = np.zeros(3, int), set()
    for offset in OFFSETS:
        packed = alone(random_shape(shape, rng, 1.0, offset * rng.normal(size=3)))
        hits, misses, worst, close = compare(packed, *rays_about(packed, rng))
        print(f"{name(shape)} at {offset}: {hits} hits, {misses} misses, t off by {worst:.2f}, {close} close")
        assert worst <= T_ULPS
        total += hits, misses, close
        kinds.add(type(packed.parts[0]))
    assert total[0] >= 50 and total[1] >= 15 and total[2] <= total.sum() // 10, f"{total} hits, misses, too close"
    assert kinds == {type(random_shape(shape, rng).pack(as_given)) for _ in range(30)}, "a kind was left out"


def ball(center, radius: float) -> Packed:
    return alone(Sphere(center=center, radius=radius))


@pytest.mark.parametrize("distance", [1e1, 1e3, 1e6, 1e7, 1e8])
def test_distant_small_spheres_are_hit_at_the_exact_t(distance):
    """Where the textbook's b^2 - a c has lost all its digits: 1e16 times the squared radius."""
    rng = np.random.default_rng([71, int(np.log10(distance))])
    center, radius = rng.normal(size=3), float(10.0 ** rng.uniform(-3.0, 3.0))
    away = rng.normal(size=(200, 3))
    o = center + distance * radius * away / np.linalg.norm(away, axis=1, keepdims=True)
    aside = rng.uniform(-1.0, 1.0, (200, 3))
    hits, misses, worst, _ = compare(ball(center, radius), o, center + radius * aside - o)
    assert hits >= 100 and misses >= 20
    assert worst <= T_ULPS


def test_the_far_root_is_hit_from_inside():
    rng = np.random.default_rng(72)
    center, radius = rng.normal(size=3), 0.7
    outwards = rng.normal(size=(200, 3))
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    depth = 10.0 ** rng.uniform(-8.0, 0.0, (200, 1))  # below the surface, in radii
    hits, misses, worst, _ = compare(ball(center, radius), center + radius * (1.0 - depth) * outwards, outwards)
    assert hits >= 190 and misses == 0
    assert worst <= T_ULPS


def test_a_tangent_touches_a_sphere_and_one_ulp_beyond_it_passes():
    x = np.array([1.0, np.nextafter(1.0, 0.0), np.nextafter(1.0, 2.0)])
    o = np.stack([x, np.zeros(3), np.full(3, -5.0)], axis=1)
    ours = find_nearest(ball((0, 0, 0), 1.0), validated_rays(o, np.tile([0.0, 0.0, 1.0], (3, 1)), 0.0, np.inf))
    half_chord = np.sqrt((1.0 - x[1]) * (1.0 + x[1]))
    assert ours.t[0] == 5.0
    assert abs(ours.t[1] - (5.0 - half_chord)) <= ULP * 5.0
    assert ours.prim[2] == -1


def test_a_wrong_t_is_detected():
    """What the comparison measures: t off by a hundredth of a millionth is far beyond 4 ulps."""
    packed = ball((0, 0, 0), 1.0)
    (answer,) = answers(packed.kinds[0].prims, (0.1, 0.2, -5.0), (0.0, 0.0, 1.0))
    t = float(answer.t)
    assert error_in_ulps(t, answer) <= 1.0
    assert error_in_ulps(t * (1.0 + 1e-14), answer) > T_ULPS


def test_a_kind_without_an_oracle_is_named():
    class Cones(NamedTuple):
        apex: np.ndarray

    with pytest.raises(AssertionError, match=r"Cones: .*add it to EXACT in tests/agreement/exact.py"):
        oracle(Cones(np.zeros((1, 3))))

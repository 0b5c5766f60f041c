"""What is handled as vectors gives what its plain text says, bit for bit."""

import numpy as np
import pytest

from caster.jit import simd
from caster.jit.decorators import jit
from caster.jit.kernel_cache import COMPILED
from caster.jit.simd import CHILDREN, LANES
from caster.kernels.bvh.traversal import PacketBoxSetup, RayBoxSetup

pytestmark = pytest.mark.skipif(not COMPILED, reason="without Numba there is only the plain text")


@jit
def intersect_boxes(boxes, node, view, t_min, t_max, near):
    return simd.intersect_boxes(boxes, node, view, t_min, t_max, near)


@jit
def intersect_boxes_packet(boxes, node, view, t_min, t_max, near):
    return simd.intersect_boxes_packet(boxes, node, view, t_min, t_max, near)


@jit
def small_ones(numbers, i, j, limit, mask, answers):
    a, b = np.uint64(i), np.uint64(j)
    answers[0], answers[1] = simd.lane_min(numbers, a), simd.lane_max(numbers, a)
    answers[2] = simd.lane_max_of_sums(numbers, a, b)
    answers[3] = 1.0 if simd.any_sum_reaches(numbers, a, b, limit) else 0.0
    answers[4] = simd.lowest_bit(mask)


def wide(rng, *shape):
    """Numbers of all sizes, some 0, some infinite, as t of a miss is."""
    numbers = rng.normal(size=shape) * 10.0 ** rng.integers(-9, 9, shape)
    return np.where(rng.random(shape) < 0.05, rng.choice([0.0, -0.0, np.inf], shape), numbers)


def some_boxes(rng):
    low, high = np.sort(rng.uniform(-1.0, 1.0, (2, 5, 3, CHILDREN)), axis=0)
    none = rng.random((5, 1, CHILDREN)) < 0.2
    return np.concatenate([np.where(none, 2.0, low), np.where(none, -2.0, high)], axis=1).astype(np.float32)


def one_view(rng):
    near = tuple(int(c + 3 * rng.integers(2)) for c in range(3))
    inverse, enter, leave = (tuple(rng.normal(size=3).tolist()) for _ in range(3))
    return RayBoxSetup(near, tuple((3, 5, 7)[c] - near[c] for c in range(3)), inverse, enter, leave)


def several_views(rng):
    one, most = one_view(rng), tuple(rng.normal(size=3).tolist())
    enter = tuple(-np.inf if rng.random() < 0.1 else x for x in one.enter)
    return PacketBoxSetup(
        one.near, one.far, one.inverse, most, enter, one.leave, 2.0 ** int(rng.integers(-3, 4))
    )


@pytest.mark.parametrize(
    ("compiled", "plain", "a_view"),
    [
        (intersect_boxes, simd.intersect_boxes, one_view),
        (intersect_boxes_packet, simd.intersect_boxes_packet, several_views),
    ],
    ids=["one ray", "several rays"],
)
def test_boxes_are_entered_alike(compiled, plain, a_view):
    rng = np.random.default_rng(31)
    masks = []
    for _ in range(300):
        boxes, view, node = some_boxes(rng), a_view(rng), int(rng.integers(5))
        near = np.zeros((2, CHILDREN))
        limits = 0.0, float(rng.choice([1.0, 10.0, np.inf]))
        masks.append(compiled(boxes, node, view, *limits, near[0]))
        assert masks[-1] == plain(boxes, node, view, *limits, near[1])
        assert (near[0] == near[1]).all()
    assert len(set(masks)) > 20  # some of everything


def test_numbers_of_lanes_are_chosen_alike():
    rng = np.random.default_rng(32)
    for _ in range(300):
        numbers, mask = wide(rng, 4 * LANES), int(rng.integers(1, 1 << CHILDREN))
        i, j = rng.integers(0, 3 * LANES, 2).tolist()
        limit, answers = float(rng.normal()), np.zeros(5)
        small_ones(numbers, i, j, limit, mask, answers)
        assert answers.tolist() == [
            simd.lane_min(numbers, i),
            simd.lane_max(numbers, i),
            simd.lane_max_of_sums(numbers, i, j),
            float(simd.any_sum_reaches(numbers, i, j, limit)),
            simd.lowest_bit(mask),
        ]

"""Vector operations agree with NumPy to the bit."""

from typing import Any

import numpy as np
import pytest
from marks import compiled_only
from same_bits import bits

from caster.jit import simd
from caster.jit.decorators import jit
from caster.jit.kernel_cache import COMPILED
from caster.jit.simd import CHILDREN, LANES
from caster.kernels.bvh.traversal import RayAxis
from caster.kernels.math import lanes
from caster.kernels.math.vec import TINY

# NumPy's scalars warn of an overflow, machine code does not
pytestmark = [] if COMPILED else pytest.mark.filterwarnings("ignore::RuntimeWarning")


def wide(rng, *shape):
    """Numbers of all sizes, some 0, some infinite, as t of a miss is."""
    numbers = rng.normal(size=shape) * 10.0 ** rng.integers(-9, 9, shape)
    return np.where(rng.random(shape) < 0.05, rng.choice([0.0, -0.0, np.inf], shape), numbers)


# ---- operations of vectors: compiled, and as NumPy has them ----

PAIRS = (np.add, np.subtract, np.multiply, np.fmax, np.fmin)


@jit
def every_operation(a: Any, singles: Any, bits: int, out: Any, answers: Any) -> None:
    v, w = simd.load_lanes(a, 3), simd.load_lanes(a, 17)
    simd.store(v + w, out, 0)
    simd.store(v - w, out, 8)
    simd.store(v * w, out, 16)
    simd.store(simd.larger(v, w), out, 24)
    simd.store(simd.lesser(v, w), out, 32)
    simd.store(simd.select(bits, v, w), out, 40)
    simd.store(simd.splat(a[2]), out, 48)
    simd.store(simd.load_children(singles, 2), out, 56)
    answers[0], answers[1] = simd.bits_below(v, w), simd.bits_up_to(v, w)
    answers[2], answers[3] = simd.bits_below(v, v), simd.bits_up_to(v, v)
    answers[4] = simd.lowest_bit(bits)
    out[64], out[65] = simd.least(v), simd.largest(v)


@compiled_only
def test_operations_of_vectors_are_those_of_numpy():
    rng = np.random.default_rng(32)
    for _ in range(300):
        a, singles, chosen = wide(rng, 25), wide(rng, 10).astype(np.float32), int(rng.integers(1, 256))
        a[17:20] = a[3:6]  # some are equal
        v, w, out, answers = a[3:11], a[17:25], np.zeros(66), np.zeros(5, np.int64)
        with np.errstate(all="ignore"):
            pairs = [function(v, w) for function in PAIRS]
        picked = np.where(chosen >> np.arange(8) & 1, v, w)
        expected = np.concatenate([*pairs, picked, np.full(8, a[2]), singles[2:], [v.min(), v.max()]])
        every_operation(a, singles, chosen, out, answers)
        assert np.array_equal(out, expected, equal_nan=True)
        below, up_to = (int(np.packbits(flags, bitorder="little")[0]) for flags in (v < w, v <= w))
        assert answers.tolist() == [below, up_to, 0, 255, (chosen & -chosen).bit_length() - 1]


# ---- tests of several numbers, boxes and points ----


def packed_bits(flags):
    return sum(int(flag) << n for n, flag in enumerate(flags))


def some_boxes(rng):
    low, high = np.sort(rng.uniform(-1.0, 1.0, (2, 5, 3, CHILDREN)), axis=0)
    none = rng.random((5, 1, CHILDREN)) < 0.2
    return np.concatenate([np.where(none, 2.0, low), np.where(none, -2.0, high)], axis=1).astype(np.float32)


def a_view(rng):
    """Of several rays, or of one: with the same direction twice."""
    near, unit = [int(c + 3 * rng.integers(2)) for c in range(3)], 2.0 ** int(rng.integers(-3, 4))
    least, most, enter, leave = rng.normal(size=(4, 3))
    if rng.random() < 0.25:
        most = least
    if rng.random() < 0.25:  # left half an ulp before it is entered: the padding decides
        least, most, enter, leave, unit = np.ones(3), np.ones(3), np.ones(3), np.full(3, 1.0 - 2.0**-53), 0.0
    enter = np.where(rng.random(3) < 0.1, -np.inf, enter)
    rows = np.transpose([least, most, enter, leave]).tolist()
    return tuple(RayAxis(row, *each, unit) for row, each in zip(near, rows, strict=True))


def sides(boxes, node, view):
    """Near and far sides (3, 8) of boxes, and the numbers of each axis but its rows (n, 3, 1)."""
    near = [axis.near for axis in view]
    far = [c + 3 if row < 3 else c for c, row in enumerate(near)]
    return *(boxes[node, rows].astype(float) for rows in (near, far)), np.array(view).T[1:, :, None]


PADDING = 1.0 + 6.0 * 2.0**-53 / (1.0 - 3.0 * 2.0**-53)  # 1 + 2 gamma_3, of Ize (2013)
LATEST = np.finfo(np.float64).max


def entered(enter, leave, t_min, t_max):
    """(bits of boxes, where each is entered) of slabs (3, 8)."""
    enter, leave = np.maximum(enter.max(axis=0), t_min), np.minimum(leave.min(axis=0) * PADDING, t_max)
    return packed_bits(enter <= leave), np.minimum(enter, LATEST)


def entered_by_rays(boxes, node, view, *limits):
    near, far, (least, most, enter, leave, unit) = sides(boxes, node, view)
    begin, end = near * unit + enter, far * unit + leave
    with np.errstate(invalid="ignore"):
        return entered(np.fmin(begin * least, begin * most), np.fmax(end * least, end * most), *limits)


def test_boxes_are_entered_as_the_formula_says():
    rng, masks = np.random.default_rng(31), []
    for _ in range(600):
        boxes, view, node, near = some_boxes(rng), a_view(rng), int(rng.integers(5)), np.zeros(CHILDREN)
        limits = 0.0, float(rng.choice([1.0, 10.0, np.inf]))
        masks.append(lanes.intersect_boxes(boxes, node, view, *limits, near))
        mask, where = entered_by_rays(boxes, node, view, *limits)
        assert masks[-1] == mask and np.array_equal(near, where)
    assert len(set(masks)) > 20  # some of everything


def a_range(rng):
    """Numbers of primitives in a tile, some of misses, a place, and a range that may begin and end with them."""
    low = float(rng.integers(-1, 3))
    return rng.integers(-1, 6, 4 * LANES).astype(float), int(rng.integers(3 * LANES)), low, low + rng.integers(1, 4)


def some_lines(rng):
    return tuple(tuple(map(float, rng.integers(-3, 4, 3))) for _ in range(3))


def a_plane(rng):
    return tuple(tuple(rng.normal(size=3).tolist()) for _ in range(2)), tuple((0.3 * rng.random(3)).tolist())


@jit
def sum_reaches(numbers: Any, first: int, second: int, limit: float) -> int:
    return int(lanes.any_sum_reaches(numbers, first, second, limit))


def checks(rng):
    """(name, result, expected result) for each function of lanes.py."""
    numbers, i, low, end = a_range(rng)
    sizes, (j, k) = wide(rng, 4 * LANES), rng.integers(0, 3 * LANES, 2).tolist()
    first, second = sizes[j : j + LANES], sizes[k : k + LANES]
    most = float((first + second).max())
    yield "lane_min", lanes.lane_min(sizes, j), first.min()
    yield "lane_max", lanes.lane_max(sizes, j), first.max()
    yield "lane_max_of_sums", lanes.lane_max_of_sums(sizes, j, k), most
    yield "any_sum_reaches", sum_reaches(sizes, j, k, most), True
    if most < np.inf:
        yield "any_sum_reaches", sum_reaches(sizes, j, k, float(np.nextafter(most, np.inf))), False
    taken = numbers[i : i + LANES]
    within = (low <= taken) & (taken < end)
    yield "lanes_in_range", lanes.lanes_in_range(numbers, i, low, end), packed_bits(within)
    out, expected = wide(rng, 4 * LANES), None
    expected = out.copy()
    expected[j : j + LANES] = np.where(within, taken - low, 0.0)
    lanes.numbers_in_range(numbers, i, low, end, out, j)
    yield "numbers_in_range", out.tolist(), expected.tolist()
    boxes, limits, lines = rng.integers(-4, 5, 3 * 5 * CHILDREN).astype(float), rng.integers(-2, 4, 5), some_lines(rng)
    node = int(rng.integers(3))
    fields = boxes.reshape(3, 5, CHILDREN)[node]
    below = packed_bits((fields <= limits[:, None]).all(axis=0))
    yield "boxes_below", lanes.boxes_below(boxes, node, tuple(map(float, limits))), below
    reached = [
        np.maximum(a * fields[0], -a * fields[1]) + np.maximum(b * fields[2], -b * fields[3]) + c for a, b, c in lines
    ]
    holds = np.all(np.array(reached) >= 0.0, axis=0)
    # of a box of integers that is there; of others, least and largest are the wrong way round
    there = packed_bits((fields[0] <= -fields[1]) & (fields[2] <= -fields[3]))
    yield "boxes_reach_lines", lanes.boxes_reach_lines(boxes, node, lines) & there, packed_bits(holds) & there
    points = rng.integers(-3, 4, 3 * LANES).astype(float)
    x, y = points.reshape(3, LANES)[:2]
    inside = np.all([a * x + b * y + c >= 0.0 for a, b, c in lines], axis=0)
    yield "lanes_within_lines", lanes.lanes_within_lines(points, 0, LANES, lines), packed_bits(inside)
    (p, normal), error = a_plane(rng)
    away = np.array(p)[:, None] - points.reshape(3, LANES)
    height = normal[0] * away[0] + normal[1] * away[1] + normal[2] * away[2]
    off = error[0] * abs(away[0]) + error[1] * abs(away[1]) + error[2] * abs(away[2]) + TINY
    above = lanes.lanes_above(points, 0, LANES, 2 * LANES, (p, normal, error))
    yield "lanes_above", above, packed_bits(height > off)


def test_numbers_boxes_and_points_are_chosen_as_numpy_chooses_them():
    rng = np.random.default_rng(34)
    for _ in range(300 if COMPILED else 30):
        for name, found, expected in checks(rng):
            assert found == expected, name


@jit
def corners_of(rows: Any, faces: Any, out: Any, numbers: int, into: int, step: int) -> None:
    simd.gather_corners(rows, faces, out, numbers, into, step)


def test_corners_of_faces_are_gathered_coordinate_by_coordinate():
    rng = np.random.default_rng(35)
    for _ in range(100):
        rows, faces = wide(rng, 5, 3), rng.integers(0, 5, (6, 3)).astype(np.int32)
        faces[rng.integers(6), rng.integers(3)] = 4  # some face has the last row
        out = wide(rng, 10 * LANES)
        numbers, into = (0, LANES) if rng.random() < 0.5 else (9 * LANES, 0)
        chosen = rng.integers(0, 6, LANES)
        out[numbers : numbers + LANES] = chosen
        expected = out.copy()
        expected[into : into + 9 * LANES] = rows[faces[chosen]].transpose(1, 2, 0).ravel()
        corners_of(rows, faces, out, numbers, into, LANES)
        assert np.array_equal(bits(out), bits(expected))

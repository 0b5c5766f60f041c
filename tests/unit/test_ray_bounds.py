"""Where rays and packets enter and leave the boxes of a node, against formulas in NumPy and fractions."""

import math

import numpy as np
import pytest

from caster.jit.simd import CHILDREN
from caster.kernels.bvh.build import Tree
from caster.kernels.bvh.traversal import pop_beyond, push_children, ray_box_setup
from caster.kernels.math.lanes import intersect_boxes

FLAT = 2.0**-20  # what stands for 0 in a direction here


def a_tree(rng, reach):
    """One node of boxes; where an error of a bound is off, it is seen: by its reach, boxes are padded by a lot."""
    low, high = np.sort(rng.uniform(-1.0, 1.0, (2, 1, 3, CHILDREN)), axis=0)
    boxes = np.concatenate([low, high], axis=1).astype(np.float32)
    center = tuple(rng.normal(size=3).tolist())
    links, order = np.zeros((1, CHILDREN), np.int32), np.zeros(1, np.int32)
    return Tree(boxes, links, order, center, 2.0 ** int(rng.integers(-3, 4)), FLAT, 5.0, reach)


def some_direction(rng):
    """Some components 0, of either sign, or as little."""
    d = rng.normal(size=3)
    return tuple(np.where(rng.random(3) < 0.3, rng.choice([0.0, -0.0, 2.0**-30, -(2.0**-30)], 3), d).tolist())


def packet_slabs(tree, origins, directions, padding):
    """(8,) each: where the first ray between these bounds enters the boxes, the last one leaves them, axis by axis.

    Of an axis, numbers of an origin and of a direction at the ends of the bounds are what decides; along one on which
    rays go forwards and backwards nothing is known.
    """
    enter, leave = np.full(CHILDREN, -math.inf), np.full(CHILDREN, math.inf)
    for axis in range(3):
        low, high = directions[:, axis]
        if low < 0.0 < high:
            continue
        forwards = low >= 0.0
        sides = tree.unit * tree.boxes[0, [axis, axis + 3]].astype(float) + tree.center[axis]
        first, last = sides if forwards else sides[::-1]
        over = np.where(np.abs([low, high]) < FLAT, FLAT if forwards else -FLAT, [low, high])[:, None, None]
        pad, o = padding if forwards else -padding, origins[:, axis, None]
        enter = np.maximum(enter, ((first - pad - o) / over).min(axis=(0, 1)))
        leave = np.minimum(leave, ((last + pad - o) / over).max(axis=(0, 1)))
    return enter, leave


@pytest.mark.parametrize("spread", [0.0, 0.3], ids=["one ray", "packet"])
@pytest.mark.parametrize("reach", [0.0, 0.01])
def test_boxes_are_entered_where_the_first_ray_between_the_bounds_may_enter(reach, spread):
    rng, found = np.random.default_rng(221), {True: 0, False: 0}
    for _ in range(500):
        tree, near = a_tree(rng, reach), np.zeros(CHILDREN)
        origins = np.sort(rng.normal(size=(1, 3)) + spread * rng.normal(size=(2, 3)), axis=0)
        widths = rng.choice([0.0, 0.1, 1.0] if spread else [0.0], 3)
        directions = np.sort(np.array(some_direction(rng)) + widths * rng.normal(size=(2, 3)), axis=0)
        setup = ray_box_setup(tree, *(tuple(map(tuple, ends.tolist())) for ends in (origins, directions)))
        mask = intersect_boxes(tree.boxes, 0, setup, -1e12, 1e12, near)
        padding = reach * (float(np.abs(origins).max()) + tree.extent)
        enter, leave = packet_slabs(tree, origins, directions, padding)
        assert near == pytest.approx(np.maximum(enter, -1e12), rel=1e-9, abs=1e-9)
        for child in np.flatnonzero(np.abs(leave - enter) > 1e-9 * (np.abs(enter) + np.abs(leave))):
            assert (mask >> int(child) & 1) == (enter[child] < leave[child])
            found[bool(mask >> int(child) & 1)] += 1
    assert min(found.values()) > 300


def test_of_the_boxes_of_a_node_the_first_is_next_and_what_lies_beyond_a_limit_is_left():
    """On the stack the others have what is in them beside where they are entered; the lowest is always entered."""
    rng = np.random.default_rng(225)
    for _ in range(300):
        links, node = (rng.permutation(5 * CHILDREN).reshape(5, CHILDREN).astype(np.int32), int(rng.integers(5)))
        near, mask = rng.permutation(CHILDREN) * 0.5, int(rng.integers(1, 1 << CHILDREN))
        stack, entries = np.full(12, -1, np.int32), np.full(12, math.nan)
        entries[0] = -math.inf
        inside, top = push_children(links, node, mask, 1, (stack, entries, near))
        members = [j for j in range(CHILDREN) if mask >> j & 1]
        first = min(members, key=lambda j: near[j])
        assert inside == links[node, first] and top == len(members)
        expected = {(links[node, j], near[j]) for j in members if j != first}
        assert set(zip(stack[1:top].tolist(), entries[1:top].tolist(), strict=True)) == expected
        entries[1:top] = np.sort(entries[1:top])[::-1]
        limit = float(rng.choice([*near, -1.0, 9.0]))
        left = pop_beyond(top, limit, (stack, entries, near))
        kept = entries[1:top][::-1] > limit
        assert left == top - int(np.append(~kept, True).argmax())

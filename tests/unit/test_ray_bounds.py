"""What bounds the rays of a packet, a tile or a fan: against formulas over all of its rays, in NumPy or fractions."""

import math
from fractions import Fraction

import numpy as np
import pytest

from caster.jit.simd import CHILDREN, FAN_FIELDS, LANES, intersect_boxes, intersect_boxes_packet
from caster.kernels.bvh.build import Tree
from caster.kernels.bvh.fans import (
    BLOCKS,
    DEPTH_ROUNDING,
    FAN_LIMIT,
    GROUPS,
    ROWS,
    RUNS_ACROSS,
    Fan,
    block_corner,
    group_rays,
)
from caster.kernels.bvh.traversal import packet_box_setup, pop_beyond, push_children, ray_box_setup
from caster.kernels.raster.tile import (
    DX,
    DY,
    DZ,
    FAN_X,
    FAN_Y,
    OX,
    OY,
    OZ,
    PIXELS,
    T_ERROR,
    T_MAX,
    WIDTH,
    T,
    clear_rays,
    lane,
    new_tile,
    start_ray,
)
from caster.kernels.raster.tile_casting import any_pixel_visible, max_visible_t, min_t_per_depth
from caster.rendering.ray_tiles import new_ray_groups

FLAT = 2.0**-20  # what stands for 0 in a direction here


def a_tree(rng, reach):
    """One node of boxes; where an error of a bound is off, it is seen: by its reach, boxes are padded by a lot."""
    low, high = np.sort(rng.uniform(-1.0, 1.0, (2, 1, 3, CHILDREN)), axis=0)
    boxes = np.concatenate([low, high], axis=1).astype(np.float32)
    center = tuple(rng.normal(size=3).tolist())
    links, order = np.zeros((1, CHILDREN), np.int32), np.zeros(1, np.int32)
    return Tree(boxes, links, order, center, 2.0 ** int(rng.integers(-3, 4)), FLAT, 5.0, reach)


def exact_slabs(tree, o, d, padding):
    """(8, 2): where a ray enters and leaves the boxes of the node, widened by the padding on all sides."""
    found = []
    for child in range(CHILDREN):
        spans = []
        for axis in range(3):
            over = Fraction(d[axis]) if abs(d[axis]) > FLAT else Fraction(math.copysign(FLAT, d[axis]))
            sides = [
                Fraction(tree.center[axis]) + Fraction(tree.unit) * Fraction(float(side)) + way * padding
                for side, way in ((tree.boxes[0, axis, child], -1), (tree.boxes[0, axis + 3, child], 1))
            ]
            spans.append(sorted((side - Fraction(o[axis])) / over for side in sides))
        found.append((float(max(a for a, _ in spans)), float(min(b for _, b in spans))))
    return np.array(found)


def some_direction(rng):
    """Some components 0, of either sign, or as little."""
    d = rng.normal(size=3)
    return tuple(np.where(rng.random(3) < 0.3, rng.choice([0.0, -0.0, 2.0**-30, -(2.0**-30)], 3), d).tolist())


@pytest.mark.parametrize("reach", [0.0, 0.01])
def test_boxes_are_entered_and_left_where_a_ray_crosses_them_with_their_padding(reach):
    rng, hits = np.random.default_rng(220), 0
    for _ in range(60):
        tree, o, d = a_tree(rng, reach), tuple(rng.normal(size=3).tolist()), some_direction(rng)
        near, padding = np.zeros(CHILDREN), Fraction(reach) * (max(Fraction(abs(x)) for x in o) + 5)
        mask = intersect_boxes(tree.boxes, 0, ray_box_setup(tree, o, d), -math.inf, math.inf, near)
        expected = exact_slabs(tree, o, d, padding)
        assert near == pytest.approx(expected[:, 0], rel=1e-9, abs=1e-9)
        for child, (enter, leave) in enumerate(expected.tolist()):
            if abs(leave - enter) > 1e-9 * (abs(enter) + abs(leave)):
                assert (mask >> child & 1) == (enter < leave)
        hits += mask.bit_count()
    assert 20 < hits < 300


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


@pytest.mark.parametrize("reach", [0.0, 0.01])
def test_boxes_are_entered_by_a_packet_where_the_first_ray_between_its_bounds_may_enter(reach):
    rng, found = np.random.default_rng(221), {True: 0, False: 0}
    for _ in range(300):
        tree, near = a_tree(rng, reach), np.zeros(CHILDREN)
        origins = np.sort(rng.normal(size=(1, 3)) + 0.3 * rng.normal(size=(2, 3)), axis=0)
        widths = rng.choice([0.0, 0.1, 1.0], 3)
        directions = np.sort(np.array(some_direction(rng)) + widths * rng.normal(size=(2, 3)), axis=0)
        setup = packet_box_setup(tree, *(tuple(map(tuple, ends.tolist())) for ends in (origins, directions)))
        mask = intersect_boxes_packet(tree.boxes, 0, setup, -1e12, 1e12, near)
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


def random_tile(rng, box):
    """Rays of a box with what they have met, in whole vectors of lanes; far more of the same beyond the box."""
    tile = new_tile()
    for at in (DX, DY, DZ):
        tile[int(at) : int(at) + PIXELS] = rng.normal(size=PIXELS)
    tile[int(T) : int(T) + PIXELS] = rng.uniform(1.0, 9.0, PIXELS)
    tile[int(T_ERROR) : int(T_ERROR) + PIXELS] = rng.uniform(0.0, 1.0, PIXELS)
    y, x = np.divmod(np.arange(PIXELS), WIDTH)
    inside = (x < box[2] - box[0]) & (y < box[3] - box[1])
    for at in (T, DX, DY, DZ):
        tile[int(at) : int(at) + PIXELS][~inside] *= 100.0
    return tile, inside


@pytest.mark.parametrize("box", [(128, 64, 128 + 5 * LANES, 71), (0, 0, LANES, 1), (0, 64, 128, 66)])
def test_the_largest_visible_t_and_depth_per_t_of_a_tile_are_those_of_its_pixels(box):
    rng = np.random.default_rng(222)
    tile, inside = random_tile(rng, box)
    t, error = (tile[int(at) : int(at) + PIXELS] for at in (T, T_ERROR))
    assert max_visible_t(tile, box) == (t + error)[inside].max()
    for n in (np.flatnonzero(inside)[0], np.flatnonzero(inside)[-1]):
        kept, t[n] = t[n], math.inf
        assert max_visible_t(tile, box) == math.inf
        t[n] = kept
    d = np.column_stack([tile[int(at) : int(at) + PIXELS] for at in (DX, DY, DZ)])[inside]
    for forward in np.eye(3):
        most = (d @ forward).max()
        assert min_t_per_depth(tile, box, tuple(forward)) == (1.0 / most if most > 0.0 else 0.0)
    askew = (0.25, -0.5, 0.75)
    most = float((d @ askew).max())
    assert min_t_per_depth(tile, box, askew) == pytest.approx(1.0 / most if most > 0.0 else 0.0, rel=1e-14)
    assert min_t_per_depth(tile, box, (0.0, 0.0, 0.0)) == 0.0


def test_a_span_is_visible_where_a_pixel_of_it_may_show_what_lies_so_near():
    rng = np.random.default_rng(223)
    tile, _ = random_tile(rng, (0, 0, 128, 64))
    latest = sum(tile[int(at) : int(at) + PIXELS] for at in (T, T_ERROR)).reshape(-1, WIDTH)
    for _ in range(200):
        x = np.sort(rng.choice(128 // LANES + 1, 2, replace=False)) * LANES
        y = np.sort(rng.choice(65, 2, replace=False))
        if np.prod(y[1] - y[0]) * (x[1] - x[0]) > 400:
            continue
        near = float(latest[y[0] : y[1], x[0] : x[1]].max())
        rect = int(x[0]), int(y[0]), int(x[1]), int(y[1])
        assert any_pixel_visible(tile, rect, near)
        assert not any_pixel_visible(tile, rect, math.nextafter(near, math.inf))


AXES = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
FANS = {
    "to a point": (Fan(1.0, (1.0, -2.0, 4.0), (0.0, 0.0, 0.0), *AXES, 50.0, 0.0), False),
    "from a point": (Fan(1.0, (1.0, -2.0, 4.0), (0.0, 0.0, 0.0), *AXES, 50.0, 0.0), True),
    "parallel": (Fan(0.0, (0.0, 0.0, 0.0), (0.0, 0.0, -1.0), *AXES, 50.0, 0.0), False),
}


def fan_tile(rng, fan, outward, rows):
    """Runs of rays that belong to the fan but for single ones; single rays are missing, and some whole runs."""
    tile = new_tile()
    clear_rays(tile, 0, PIXELS)
    for run in range(rows * RUNS_ACROSS):
        kind = rng.choice(["belongs", "belongs", "none", "aside", "behind", "far away"])
        stray = int(rng.integers(LANES))
        for n in range(LANES):
            place = np.array([*rng.uniform(-1.9, 1.9, 2), 1.0]) * rng.uniform(0.5, 3.0)
            if kind == "none" or (n != stray and rng.random() < 0.1):
                continue
            if n == stray and kind in ("aside", "behind"):
                place = place * [1.0, 1.0, -1.0] if kind == "behind" else [*(3.0 * place[2], place[1]), place[2]]
            o = np.array(fan.origin) + (0.0 if outward else place)
            if n == stray and kind == "far away":
                o += np.array([0.0, 51.0, 0.0])
            d = place if outward else (np.array(fan.origin) - o if fan.perspective else np.array(fan.back))
            start_ray(tile, lane(run * LANES + n), (tuple(o), tuple(d), 0.0, float(rng.uniform(0.5, 2.0))))
    t = tile[int(T) : int(T) + PIXELS]
    t[rng.random(PIXELS) < 0.3] = rng.uniform(0.2, 1.0)
    return tile


@pytest.mark.parametrize("rows", [8, 20])
@pytest.mark.parametrize("name", FANS)
def test_runs_of_a_fan_are_bounded_by_their_rays_and_blocks_by_their_runs(name, rows):
    (fan, outward), rng = FANS[name], np.random.default_rng(224)
    tile, groups = fan_tile(rng, fan, outward, rows), new_ray_groups()
    groups.taken[5] = 1  # by an earlier fan
    group_rays(fan, tile, rows, groups, outward)
    field = {at: tile[int(at) : int(at) + PIXELS].reshape(-1, RUNS_ACROSS, LANES) for at in (DX, DY, DZ, T, T_MAX)}
    from_o = [tile[int(at) : int(at) + PIXELS].reshape(-1, RUNS_ACROSS, LANES) for at in (OX, OY, OZ)]
    away = [field[at] for at in (DX, DY, DZ)] if outward else [a - b for a, b in zip(from_o, fan.origin, strict=True)]
    there, depth = field[T_MAX] >= 0.0, away[2]
    over = np.where((depth > 0.0) & bool(fan.perspective), depth, 1.0)
    x, y = away[0] / over, away[1] / over
    ahead = (depth > 0.0) & (np.abs(x) <= FAN_LIMIT) & (np.abs(y) <= FAN_LIMIT)
    near = np.maximum.reduce([np.abs(a) for a in from_o]) <= fan.reach
    belongs = (~there | (near & (ahead | (fan.perspective == 0.0)))).all(axis=2)
    boxes, blocks = (
        groups.runs.reshape(BLOCKS, FAN_FIELDS, CHILDREN),
        groups.blocks.reshape(GROUPS, FAN_FIELDS, CHILDREN),
    )
    counts = [0, 0]
    for block in range(BLOCKS):
        for r in range(ROWS):
            row, run = np.divmod(block_corner(block) + r * WIDTH, WIDTH)
            run, number = run // LANES, row * RUNS_ACROSS + run // LANES
            expected = np.full(FAN_FIELDS, math.inf)
            if row < rows and number != 5 and there[row, run].any():
                counts[int(not belongs[row, run])] += 1
                assert groups.taken[number] == belongs[row, run]
                if belongs[row, run]:
                    rays = there[row, run]
                    ends = [x[row, run][rays], -x[row, run][rays], y[row, run][rays], -y[row, run][rays]]
                    expected = np.array([*(e.min() for e in ends), -depth[row, run][rays].max()])
                    if outward:
                        deepest = depth[row, run][rays].max()
                        stretch = deepest * DEPTH_ROUNDING
                        assert stretch > deepest * (1.0 + 20.0 * 2.0**-53)  # what products with it are off by
                        t = np.where(rays, field[T][row, run], -1.0)
                        expected[4] = -stretch * min(field[T_MAX][row, run].max(), t.max())
                        assert groups.stretch[block * ROWS + r] == stretch
            elif row < rows:
                assert groups.taken[number] == 1
            assert boxes[block, :, r].tolist() == expected.tolist(), (block, r)
        least = boxes[block].min(axis=1)
        assert blocks[block // CHILDREN, :, block % CHILDREN].tolist() == least.tolist()
    assert groups.counts.tolist() == counts and min(counts[0], counts[1] + (fan.perspective == 0.0) * 99) > 20 // LANES
    kept = belongs[:rows] & there[:rows].any(axis=2)
    for at, expected in ((FAN_X, np.where(there, x, np.nan)), (FAN_Y, y)):
        found = tile[int(at) : int(at) + PIXELS].reshape(-1, RUNS_ACROSS, LANES)[:rows]
        kept[0, 5] = False
        np.testing.assert_array_equal(found[kept][there[:rows][kept]], expected[:rows][kept][there[:rows][kept]])

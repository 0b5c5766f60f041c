"""Faults of lanes, which plain Python has not: planted in the intrinsics and in kernels of tiles and packets, compiled.

Intrinsics are held to their plain text, kernels to NumPy over whole arrays. Each fault compiles the one intrinsic or
kernel that shows it, in this process. All of them by `make faults` (FAULTS=all).
"""

import math
import os
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from test_lanes import (
    a_range,
    a_range_and_lanes,
    one_view,
    several_views,
    some_boxes,
    some_faces,
    wide,
    written_differently,
)

from caster.jit import simd, vector_intrinsics
from caster.jit.decorators import jit
from caster.jit.kernel_cache import COMPILED
from caster.jit.simd import CHILDREN, FAR_PADDING, LANES, LARGEST_T
from caster.kernels.bvh import traversal
from caster.kernels.raster import tile as tiles
from caster.kernels.raster import tile_casting

pytestmark = pytest.mark.skipif(not COMPILED, reason="without Numba nothing is compiled")

ROUNDS = 200  # of random numbers; every fault shows within the first few


class Fault(NamedTuple):
    """An edit of caster/jit/vector_intrinsics.py, and the intrinsic that shows it."""

    what: str
    shown_by: str
    old: str
    new: str


ZEXT = "return self.builder.zext(self.builder.bitcast(comparison, ir.IntType(self.lanes)), INT64)"

FAULTS = (
    Fault("the first lane masked out", "one ray", ZEXT, f"return self.builder.and_({ZEXT[7:]}, INT64(-2))"),
    Fault(
        "the last lane masked out",
        "several rays",
        ZEXT,
        f"return self.builder.and_({ZEXT[7:]}, INT64((1 << self.lanes - 1) - 1))",
    ),
    Fault(
        "loaded one lane late",
        "lane_min",
        "self.builder.gep(data, [at])",
        "self.builder.gep(data, [self.builder.add(at, at.type(1))])",
    ),
    Fault("the tail of a reduction dropped", "lane_max", "range(half, 2 * half)", "range(half)"),
    Fault("least and largest swapped", "lane_min", 'fcmp_ordered("<", a, b)', 'fcmp_ordered(">", a, b)'),
    Fault(
        "an equal sum does not reach",
        "any_sum_reaches",
        'ordered(">=", total, vectors.all(arguments[3])',
        'ordered(">", total, vectors.all(arguments[3])',
    ),
    Fault("the last axis forgotten", "one ray", "for axis in (1, 2):", "for axis in (1,):"),
    Fault("far sides unpadded", "one ray", "vectors.lesser(builder.fmul(leave, padding), ", "vectors.lesser(leave, "),
    Fault("an endless t stored", "several rays", "vectors.lesser(enter, latest)", "enter"),
    Fault(
        "rounded to float32",
        "one ray",
        "builder.fadd(builder.fmul(children.row(near), slope), vectors.all(enter)),",
        "builder.fpext(builder.fptrunc(builder.fadd(builder.fmul(children.row(near), slope), vectors.all(enter)),"
        " ir.VectorType(FLOAT32, vectors.lanes)), vectors.reals),",
    ),
    Fault("x twice", "gather_corners", "range(axis, 2 * self.lanes, 2)", "range(0, 2 * self.lanes, 2)"),
    Fault("y for z", "gather_corners", "builder.add(start, INT64(2))", "builder.add(start, INT64(1))"),
    Fault("one corner three times", "gather_corners", "builder.add(at, INT64(corner))", "at"),
    Fault("corners one coordinate apart", "gather_corners", "INT64(3 * corner + axis)", "INT64(corner + axis)"),
    Fault(
        "the end in the range", "lanes_in_range", 'fcmp_ordered("<", numbers, end)', 'fcmp_ordered("<=", numbers, end)'
    ),
    Fault(
        "the least out of the range",
        "lanes_in_range",
        'fcmp_ordered("<=", least, numbers)',
        'fcmp_ordered("<", least, numbers)',
    ),
    Fault("counted from 0", "numbers_in_range", "builder.fsub(numbers, least)", "numbers"),
    Fault("the highest bit for the lowest", "lowest_bit", "builder.cttz", "builder.ctlz"),
    Fault("one array twice in a sum", "lane_max_of_sums", "builder.fadd(first, *more)", "builder.fadd(first, first)"),
)
QUICK = ("the first lane masked out", "the tail of a reduction dropped", "loaded one lane late")
CHOSEN = [each for each in FAULTS if each.what in QUICK or os.environ.get("FAULTS") == "all"]


def edited(old: str = "", new: str = "", of: types.ModuleType = vector_intrinsics) -> types.ModuleType:
    """A module, the intrinsics, with text replaced that is there exactly once."""
    source = Path(str(of.__file__)).read_text(encoding="utf-8")
    if old:
        assert source.count(old) == 1, f"found {source.count(old)} times: {old!r}"
        source = source.replace(old, new)
    module = types.ModuleType("edited")
    exec(compile(source, "edited", "exec"), module.__dict__)
    return module


GIVEN = {"lanes_in_range": a_range, "numbers_in_range": a_range_and_lanes, "gather_corners": some_faces}


def differs(vectors: types.ModuleType, name: str) -> bool:
    """Whether an intrinsic, compiled, and its plain text give another bit anywhere."""
    import numba

    made = numba.extending.intrinsic
    rng = np.random.default_rng(33)
    if name in ("one ray", "several rays"):
        which = "intersect_boxes" if name == "one ray" else "intersect_boxes_packet"
        inner = made(getattr(vectors, which)(CHILDREN, numba.types, FAR_PADDING, LARGEST_T))
        boxes_entered = numba.njit(error_model="numpy")(lambda b, k, v, t, u, near: inner(b, k, v, t, u, near))
        plain, view_of = getattr(simd, which), one_view if name == "one ray" else several_views
        for k in range(ROUNDS):
            boxes, view, node = some_boxes(rng), view_of(rng), int(rng.integers(5))
            if which == "intersect_boxes" and k % 4 == 0:  # left half an ulp before it is entered: padding decides
                view = view._replace(inverse=(0.0,) * 3, enter=(1.0,) * 3, leave=(1.0 - 2.0**-53,) * 3)
            near, limits = np.zeros((2, CHILDREN)), (0.0, float(rng.choice([1.0, 10.0, np.inf])))
            masks = (boxes_entered(boxes, node, view, *limits, near[0]), plain(boxes, node, view, *limits, near[1]))
            if masks[0] != masks[1] or near[0].tobytes() != near[1].tobytes():
                return True
        return False
    plain = getattr(simd, name)
    inner = made(getattr(vectors, name)(*(() if name == "lowest_bit" else (LANES,)), numba.types))
    compiled = jit(
        {
            "lowest_bit": lambda mask: inner(mask),
            "lane_min": lambda a, i: inner(a, i),
            "lane_max": lambda a, i: inner(a, i),
            "lane_max_of_sums": lambda a, i, j: inner(a, i, j),
            "any_sum_reaches": lambda a, i, j, limit: inner(a, i, j, limit),
            "lanes_in_range": lambda a, i, least, end: inner(a, i, least, end),
            "numbers_in_range": lambda a, i, least, end, out, at: inner(a, i, least, end, out, at),
            "gather_corners": lambda rows, faces, out, i, at, step: inner(rows, faces, out, i, at, step),
        }[name]
    )
    if name in GIVEN:
        return any(written_differently(compiled, plain, GIVEN[name](rng)) for _ in range(ROUNDS))
    for _ in range(ROUNDS):
        numbers = wide(rng, 4 * LANES)
        i, j = (np.uint64(x) for x in rng.integers(0, 3 * LANES, 2))
        largest = float(simd.lane_max_of_sums(numbers, int(i), int(j)))
        given = {
            "lowest_bit": (int(rng.integers(1, 1 << CHILDREN)),),
            "lane_max_of_sums": (numbers, i, j),
            "any_sum_reaches": (numbers, i, j, largest),  # just reached
        }.get(name, (numbers, i))
        if compiled(*given) != plain(*(int(x) if isinstance(x, np.uint64) else x for x in given)):
            return True
    return False


@pytest.mark.parametrize("fault", CHOSEN, ids=lambda fault: fault.what.replace(" ", "-"))
def test_a_fault_of_lanes_is_detected(fault):
    assert differs(edited(fault.old, fault.new), fault.shown_by)


@pytest.mark.parametrize("name", sorted({fault.shown_by for fault in CHOSEN}))
def test_without_a_fault_nothing_differs(name):
    assert not differs(edited(), name)


def test_every_edit_fits_the_source_of_today():
    assert len({fault.what for fault in FAULTS}) == len(FAULTS) >= 6 and set(QUICK) <= {f.what for f in FAULTS}
    for fault in FAULTS:
        edited(fault.old, fault.new)


class TileFault(NamedTuple):
    """An edit of a module of kernels, and the kernel that shows it."""

    what: str
    module: types.ModuleType
    shown_by: str
    old: str
    new: str


RESET = "    for j in range(lane(LANES)):\n        tile[SCRATCH + j] = 0.0\n    for y in range(box[3] - box[1]):\n"
ROWS = "        for first in range(lane(y * WIDTH), lane(y * WIDTH + box[2] - box[0]), lane(LANES)):\n"
LOOKED = ROWS + "            if any_sum_reaches(tile, T + first, T_ERROR + first, math.inf):"

TILE_FAULTS = (
    TileFault(
        "the last lane left out of a reduction",
        tile_casting,
        "max_visible_t",
        "    far = 0.0\n    for j in range(lane(LANES)):",
        "    far = 0.0\n    for j in range(lane(LANES - 1)):",
    ),
    TileFault(
        "a lane keeps what an earlier tile left",
        tile_casting,
        "max_visible_t",
        RESET + LOOKED,
        RESET.replace("tile[SCRATCH + j] = 0.0", "tile[SCRATCH + j] += 0.0") + LOOKED,
    ),
    TileFault(
        "rows one pixel short",
        tile_casting,
        "max_visible_t",
        LOOKED,
        LOOKED.replace(
            "range(lane(y * WIDTH), lane(y * WIDTH +", "range(lane(y * (WIDTH - 1)), lane(y * (WIDTH - 1) +"
        ),
    ),
    TileFault(
        "the reduction takes the least lane",
        tile_casting,
        "min_t_per_depth",
        "most = max(most, tile[SCRATCH + j])",
        "most = min(most, tile[SCRATCH + j]) if j else tile[SCRATCH + j]",
    ),
    TileFault(
        "a partial vector at the right border left out",
        tile_casting,
        "bounds_in_tile",
        "y_start, -(-x_stop // LANES) * LANES, y_stop",
        "y_start, x_stop // LANES * LANES, y_stop",
    ),
    TileFault(
        "a partial vector at the left border left out",
        tile_casting,
        "bounds_in_tile",
        "return x_start // LANES * LANES, y_start",
        "return -(-x_start // LANES) * LANES, y_start",
    ),
    TileFault(
        "a span's first vector alone looked at",
        tile_casting,
        "any_pixel_visible",
        "lane(y * WIDTH + x_stop), lane(LANES)):\n            if any_lane_visible",
        "lane(y * WIDTH + x_start + LANES), lane(LANES)):\n            if any_lane_visible",
    ),
    TileFault(
        "a lane that is no number is nearer",
        tiles,
        "update_nearest",
        "ahead, margin = tile[T + i] - t if t < math.inf else -math.inf, tile[T_ERROR + i] + error",
        "ahead, margin = math.inf if t != t else tile[T + i] - t, tile[T_ERROR + i] + error",
    ),
    TileFault(
        "the id of a lane written in the next one",
        tiles,
        "update_nearest",
        "tile[PRIM + i] = prim_number if nearer else tile[PRIM + i]",
        "tile[PRIM + i + lane(1)] = prim_number if nearer else tile[PRIM + i]",
    ),
    TileFault(
        "a packet's fields at the stride of a tile's row",
        traversal,
        "packet_bounds",
        "field + lane(2 * STRIDE) + first",
        "field + lane(2 * STRIDE - LANES) + first",
    ),
    TileFault(
        "a packet's least for its largest",
        traversal,
        "packet_bounds",
        "(lane_max(tile, x), lane_max(tile, y), lane_max(tile, z)),",
        "(lane_max(tile, x), lane_min(tile, y), lane_max(tile, z)),",
    ),
)
QUICK_OF_TILES = ("a partial vector at the right border left out", "a lane that is no number is nearer")
CHOSEN_OF_TILES = [each for each in TILE_FAULTS if each.what in QUICK_OF_TILES or os.environ.get("FAULTS") == "all"]


def some_tile(rng: np.random.Generator) -> np.ndarray:
    """Numbers of many sizes in all fields, also behind the last pixel of each row."""
    tile = tiles.new_tile()
    tile[:] = 10.0 ** rng.uniform(-3.0, 3.0, tile.shape)
    return tile


def field_of(tile: np.ndarray, field: int) -> np.ndarray:
    return tile[int(field) : int(field) + tiles.PIXELS].reshape(tiles.HEIGHT, tiles.WIDTH)


def whole_lanes(start: int, stop: int) -> tuple[int, int]:
    return start - start % LANES, stop + -stop % LANES


def some_span(rng: np.random.Generator) -> tuple[int, int, int, int]:
    x, y = np.sort(rng.integers(0, 40, 2)), np.sort(rng.integers(0, 5, 2))
    return int(x[0]), int(y[0]), int(x[1]) + 1, int(y[1]) + 1


def kernel_differs(module: types.ModuleType, name: str) -> bool:
    """Whether a kernel, compiled, ever gives something else than NumPy does over whole arrays."""
    inner = getattr(module, name)
    lane, direction, rng = tiles.lane, tiles.DX, np.random.default_rng(34)
    compiled = jit(
        {
            "max_visible_t": lambda tile, box: inner(tile, box),
            "min_t_per_depth": lambda tile, box, forward: inner(tile, box, forward),
            "bounds_in_tile": lambda pixels, k, box: inner(pixels, k, box),
            "any_pixel_visible": lambda tile, rect, near: inner(tile, rect, near),
            "update_nearest": lambda tile, i, number, t, error: inner(tile, lane(i), number, t, error),
            "packet_bounds": lambda tile, first: inner(tile, direction, lane(first)),
        }[name]
    )
    return any(not _agrees(compiled, name, rng) for _ in range(60))


def _agrees(compiled: Callable[..., Any], name: str, rng: np.random.Generator) -> bool:
    tile, (x0, y0, x1, y1) = some_tile(rng), some_span(rng)
    box = (1000, 500, 1000 + x1, 500 + y1)
    seen = np.s_[:y1, : whole_lanes(0, x1)[1]]
    reach = (field_of(tile, tiles.T) + field_of(tile, tiles.T_ERROR))[seen]
    if name == "max_visible_t":
        tile[int(tiles.SCRATCH) :] = 1e9  # of an earlier tile
        return bool(compiled(tile, box) == reach.max())
    if name == "min_t_per_depth":
        ahead = field_of(tile, tiles.DX) * 0.5 + field_of(tile, tiles.DY) * 0.25 + field_of(tile, tiles.DZ) * 2.0
        return bool(compiled(tile, box, (0.5, 0.25, 2.0)) == 1.0 / ahead[seen].max())
    if name == "bounds_in_tile":
        pixels = np.array([[1000 + x0, 500 + y0, 1000 + x1, 500 + y1]])
        start, stop = whole_lanes(x0, x1)
        return bool(compiled(pixels, 0, (1000, 500, 1128, 564)) == (start, y0, stop, y1))
    if name == "any_pixel_visible":
        start, stop = whole_lanes(x0, x1)
        part = (field_of(tile, tiles.T) + field_of(tile, tiles.T_ERROR))[y0:y1, start:stop]
        above = np.nextafter(part.max(), math.inf)
        rect = (start, y0, stop, y1)
        return bool(compiled(tile, rect, float(part.max())) and not compiled(tile, rect, float(above)))
    if name == "packet_bounds":
        first = LANES * int(rng.integers(tiles.PIXELS // LANES))
        parts = [field_of(tile, field).ravel()[first : first + LANES] for field in (tiles.DX, tiles.DY, tiles.DZ)]
        return bool(compiled(tile, first) == (tuple(p.min() for p in parts), tuple(p.max() for p in parts)))
    return _folds_like_numpy(compiled, tile, rng)


def _folds_like_numpy(fold: Callable[..., Any], tile: np.ndarray, rng: np.random.Generator) -> bool:
    """A packet with one lane that is no number, and one that misses: those keep what they had."""
    names = (tiles.T, tiles.T_ERROR, tiles.PRIM, tiles.UNCERTAIN)
    before = np.stack([field_of(tile, name).ravel()[: LANES + 1] for name in names])
    before[:, 0] = math.inf, 0.0, -1.0, 0.0
    for name, values in zip(names, before, strict=True):
        field_of(tile, name).ravel()[: LANES + 1] = values
    t, error = 10.0 ** rng.uniform(-3.0, 3.0, LANES), 10.0 ** rng.uniform(-6.0, 1.0, LANES)
    t[rng.permutation(LANES)[:2]] = math.nan, math.inf
    for i in range(LANES):
        fold(tile, i, 7.0, t[i], error[i])
    number = t < math.inf
    ahead = before[0, :LANES] - np.where(number, t, 0.0)
    margin = before[1, :LANES] + error
    nearer, unclear = number & (ahead > margin), number & (np.abs(ahead) <= margin)
    expected = before.copy()
    for row, new, which in zip(expected, (t, error, 7.0, 1.0), (nearer, nearer, nearer, unclear), strict=True):
        row[:LANES] = np.where(which, new, row[:LANES])
    after = np.stack([field_of(tile, name).ravel()[: LANES + 1] for name in names])
    return after.tobytes() == expected.tobytes()


@pytest.mark.parametrize("fault", CHOSEN_OF_TILES, ids=lambda fault: fault.what.replace(" ", "-"))
def test_a_fault_of_tiles_is_detected(fault):
    assert kernel_differs(edited(fault.old, fault.new, fault.module), fault.shown_by)


@pytest.mark.parametrize("name", sorted({fault.shown_by for fault in CHOSEN_OF_TILES}))
def test_without_a_fault_kernels_of_tiles_do_as_numpy_does(name):
    (module,) = {fault.module for fault in TILE_FAULTS if fault.shown_by == name}
    assert not kernel_differs(module, name)


def test_every_edit_of_tiles_fits_the_source_of_today():
    names = {fault.what for fault in TILE_FAULTS}
    assert len(names) == len(TILE_FAULTS) >= 6 and set(QUICK_OF_TILES) <= names
    for fault in TILE_FAULTS:
        edited(fault.old, fault.new, fault.module)

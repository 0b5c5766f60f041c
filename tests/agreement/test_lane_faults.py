"""Faults of lanes, which plain Python has not: planted in the intrinsics, compiled, and held to the plain text.

Each fault compiles the one intrinsic that shows it, in this process. All of them by `make faults` (FAULTS=all).
"""

import os
import types
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from test_lanes import one_view, several_views, some_boxes, wide

from caster.jit import simd, vector_intrinsics
from caster.jit.kernel_cache import COMPILED
from caster.jit.simd import CHILDREN, FAR_PADDING, LANES, LARGEST_T

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
    Fault("the tail of a reduction dropped", "lane_max", "for at in (0, half)", "for at in (0, 0)"),
    Fault(
        "least and largest swapped",
        "lane_min",
        'fcmp_ordered("<", a, b)',
        'fcmp_ordered(">", a, b)',
    ),
    Fault("an equal sum does not reach", "any_sum_reaches", 'ordered(">=", total', 'ordered(">", total'),
    Fault("the last axis forgotten", "one ray", "for axis in (1, 2):", "for axis in (1,):"),
    Fault(
        "far sides unpadded",
        "one ray",
        "vectors.lesser(builder.fmul(leave, padding), ",
        "vectors.lesser(leave, ",
    ),
    Fault("an endless t stored", "several rays", "vectors.lesser(enter, latest)", "enter"),
    Fault(
        "rounded to float32",
        "one ray",
        "builder.fadd(builder.fmul(children.row(near), slope), vectors.all(enter)),",
        "builder.fpext(builder.fptrunc(builder.fadd(builder.fmul(children.row(near), slope), vectors.all(enter)),"
        " ir.VectorType(FLOAT32, vectors.lanes)), vectors.reals),",
    ),
    Fault("the highest bit for the lowest", "lowest_bit", "builder.cttz", "builder.ctlz"),
    Fault(
        "one array twice in a sum",
        "lane_max_of_sums",
        "builder.fadd(first, *more)",
        "builder.fadd(first, first)",
    ),
)
QUICK = ("the first lane masked out", "the tail of a reduction dropped", "loaded one lane late")
CHOSEN = [each for each in FAULTS if each.what in QUICK or os.environ.get("FAULTS") == "all"]


def edited(old: str = "", new: str = "") -> types.ModuleType:
    """The intrinsics with text replaced that is there exactly once."""
    source = Path(str(vector_intrinsics.__file__)).read_text(encoding="utf-8")
    if old:
        assert source.count(old) == 1, f"found {source.count(old)} times: {old!r}"
        source = source.replace(old, new)
    module = types.ModuleType("edited_intrinsics")
    exec(compile(source, "edited_intrinsics", "exec"), module.__dict__)
    return module


def differs(vectors: types.ModuleType, name: str) -> bool:
    """Whether an intrinsic, compiled, and its plain text give another bit anywhere."""
    import numba

    made = numba.extending.intrinsic
    rng = np.random.default_rng(33)
    if name in ("one ray", "several rays"):
        which = "intersect_boxes" if name == "one ray" else "intersect_boxes_packet"
        inner = made(getattr(vectors, which)(CHILDREN, numba.types, FAR_PADDING, LARGEST_T))
        boxes_entered = numba.njit(error_model="numpy")(
            lambda b, k, v, t, u, near: inner(b, k, v, t, u, near)
        )
        plain, view_of = getattr(simd, which), one_view if name == "one ray" else several_views
        for k in range(ROUNDS):
            boxes, view, node = some_boxes(rng), view_of(rng), int(rng.integers(5))
            if (
                which == "intersect_boxes" and k % 4 == 0
            ):  # left half an ulp before it is entered: padding decides
                view = view._replace(inverse=(0.0,) * 3, enter=(1.0,) * 3, leave=(1.0 - 2.0**-53,) * 3)
            near, limits = np.zeros((2, CHILDREN)), (0.0, float(rng.choice([1.0, 10.0, np.inf])))
            masks = (
                boxes_entered(boxes, node, view, *limits, near[0]),
                plain(boxes, node, view, *limits, near[1]),
            )
            if masks[0] != masks[1] or near[0].tobytes() != near[1].tobytes():
                return True
        return False
    plain = getattr(simd, name)
    inner = made(getattr(vectors, name)(*(() if name == "lowest_bit" else (LANES,)), numba.types))
    compiled = numba.njit(error_model="numpy")(
        {
            "lowest_bit": lambda mask: inner(mask),
            "lane_min": lambda a, i: inner(a, i),
            "lane_max": lambda a, i: inner(a, i),
            "lane_max_of_sums": lambda a, i, j: inner(a, i, j),
            "any_sum_reaches": lambda a, i, j, limit: inner(a, i, j, limit),
        }[name]
    )
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
def test_a_fault_of_lanes_is_seen(fault):
    assert differs(edited(fault.old, fault.new), fault.shown_by)


@pytest.mark.parametrize("name", sorted({fault.shown_by for fault in CHOSEN}))
def test_without_a_fault_nothing_differs(name):
    assert not differs(edited(), name)


def test_every_edit_fits_the_source_of_today():
    assert len({fault.what for fault in FAULTS}) == len(FAULTS) >= 6 and set(QUICK) <= {
        f.what for f in FAULTS
    }
    for fault in FAULTS:
        edited(fault.old, fault.new)

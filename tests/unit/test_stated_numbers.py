"""Numbers that decide what passes, as data: constants, error bounds and expected sizes, input by input.

That bounds are not too small is a property (test_error_models.py, test_error_bounds_of_kernels.py). A bound that grew
would excuse more and fail nothing, so each number is in stated_numbers.json, and a changed one shows in its diff.
`python tests/unit/test_stated_numbers.py` writes the file. No sine, power or BLAS takes part: the numbers are the same
on every CPU.
"""

import importlib
import itertools
import json
import math
import pkgutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import caster
from caster.geometry.packing import packed
from caster.kernels.math.quadric_roots import quadric_roots, quadric_setup
from caster.kernels.protocol import hull_point, hull_size, intersect, load, prepare, surely_misses
from caster.kernels.triangles import fast_barycentrics
from caster.scene.model import Scene
from mitsuba_ref import error_model, oracle, shapes
from mitsuba_ref.error_model.scene_model import Side
from mitsuba_ref.error_model.tolerances import KU, KU_OURS
from mitsuba_ref.reference.shared_input import endless_rays, model_of
from mitsuba_ref.shapes import reference_of

FILE = Path(__file__).with_name("stated_numbers.json")
TURN = {"matrix": [[0.36, 0.48, -0.8, 0], [-0.8, 0.6, 0, 0], [0.48, 0.64, 0.6, 0], [0, 0, 0, 1]]}
STRETCH = {"matrix": [[2, 0.5, 0, 1], [0, 0.75, 0.25, 2], [0.125, 0, 1.5, 3], [0, 0, 0, 1]]}
MOVED = {"translate": [10, 20, 30]}
PLACE = [{"scale": 2}, TURN, MOVED]
CORNERS = ((0.0, 0.0, 0.5), (4.0, 0.25, 0.0), (0.5, 3.0, 1.0))
SMOOTH: dict[str, Any] = {
    "vertices": CORNERS,
    "normals": ((0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.0, 0.6, 0.8)),
    "uv": ((0.0, 0.25), (2.0, 0.0), (0.5, 1.0)),
}
SHAPES = {
    "sphere": caster.Sphere(center=(1, 2, 3), radius=1.5),
    "ellipsoid": caster.Sphere(to_world=[STRETCH]),
    "disk": caster.Disk(to_world=[TURN, MOVED]),
    "stretched disk": caster.Disk(to_world=[STRETCH]),
    "cylinder": caster.Cylinder(to_world=[TURN, {"scale": 2}]),
    "stretched cylinder": caster.Cylinder(to_world=[STRETCH]),
    "plane": caster.Plane(point=(1, 2, 3), normal=(1, 2, 4)),
    "smooth triangle": caster.Triangle(**SMOOTH),
    "far triangle": caster.Triangle(vertices=CORNERS, to_world=[MOVED]),
    "curve": caster.LinearCurve(points=((1, 2, 3), (4, 2.5, 1)), radii=(1.5, 0.5)),
    "ellipsoid cloud": caster.EllipsoidCloud(centers=((1, 2, 3),), scales=((1, 2, 0.5),), quaternions=((1, 2, 3, 4),)),
}
# Shapes whose packed numbers are computed a second time, with the size of what is rounded on the way.
PACKED_SHAPES = {
    "sphere": caster.Sphere(center=(1, 2, 3), radius=1.5, to_world=PLACE),
    "ellipsoid": caster.Sphere(center=(1, 2, 3), radius=1.5, to_world=[STRETCH]),
    "cloud": caster.SphereCloud(centers=((1, 2, 3), (0.5, -1, 4)), radii=(0.5, 0.25), to_world=PLACE),
    "stretched cloud": caster.SphereCloud(centers=((1, 2, 3), (0.5, -1, 4)), radius=0.75, to_world=[STRETCH]),
    "ellipsoid cloud": caster.EllipsoidCloud(
        centers=((1, 2, 3), (0.5, -1, 4)),
        scales=((1, 2, 0.5), (3, 1, 1)),
        quaternions=((1, 2, 3, 4), (0, 0, 0, 1)),
        to_world=[STRETCH],
    ),
    "curve": caster.LinearCurve(points=((1, 2, 3), (4, 2.5, 1), (5, 5, 5)), radii=(1.5, 0.5, 1.0), to_world=PLACE),
    "disk": caster.Disk(to_world=PLACE),
    "cylinder": caster.Cylinder(to_world=[STRETCH]),
    "long cylinder": caster.Cylinder(p0=(1, 2, 3), p1=(2, -1, 6), radius=0.5, to_world=PLACE),
    "plane": caster.Plane(point=(1, 2, 3), normal=(1, 2, 4), to_world=PLACE),
    "triangle": caster.Triangle(**SMOOTH, to_world=PLACE),
    "cube": caster.Cube(to_world=[STRETCH]),
    "rectangle": caster.Rectangle(to_world=[STRETCH]),
}
TARGETS = [(0.5, 0.5, 0.5), (0.1, 0.6, 0.4), (0.9, 0.2, 0.7), (0.0, 0.5, 0.5), (0.3, 0.3, 0.35), (1.0, 1.0, 0.2)]
ORIGINS = [(7.0, 3.0, 5.0), (0.25, -9.0, -40.0)]
# Both roundings as they are, and of 1/64, where terms of second order and unresolved hits show.
SIDES = {
    "reference": [Side(KU, own=False), Side(2.0**-6, own=False)],
    "ours": [Side(KU_OURS), Side(2.0**-6)],
    "foreign": [Side(KU, foreign=True)],
}
ERRORS = ("t_error", "n_error", "sh_error", "p_error", "uv_error")


def scene_of(shape: Any) -> Scene:
    camera = caster.Pinhole(eye=(0, 0, 9), look_at=(0, 0, 0))
    return Scene(film=caster.Film(width=2, height=2), camera=camera, shapes=[shape])


def constants() -> dict[str, list[float]]:
    """Every numeric constant of the error models and the oracle, by module."""
    found = {}
    for package in (error_model, shapes, oracle):
        for name in sorted(each.name for each in pkgutil.iter_modules(package.__path__)):
            module = importlib.import_module(f"{package.__name__}.{name}")
            numbers = {key: value for key, value in sorted(vars(module).items()) if key.isupper()}
            numbers = {key: value for key, value in numbers.items() if type(value) in (int, float)}
            found |= {f"{name}.{key}": [float(value)] for key, value in numbers.items()}
    return found


def bounds(shape: Any) -> dict[str, list[float]]:
    """t, error bounds and verdicts of the intersections of some rays, for each rounding."""
    scene = scene_of(shape)
    none = np.zeros((1, 3))
    model = model_of(scene, endless_rays(none, none + 1))
    low, high = (np.clip(corner, -5.0, 40.0) for corner in float_box(model.kinds[0]))
    o = np.repeat(np.array(ORIGINS) + low, len(TARGETS), axis=0).astype(np.float32).astype(float)
    d = np.tile(low + np.array(TARGETS) * (high - low), (len(ORIGINS), 1)) - o
    d = (d * 0.75).astype(np.float32).astype(float)
    found = {}
    for name, side in ((name, side) for name, sides in SIDES.items() for side in sides):
        met = model.intersect(np.zeros(len(o), np.int64), o, d, side)
        order = np.lexsort([np.nan_to_num(met.at.t), met.pair])
        for field in ("t", *ERRORS, "possible", "certain"):
            found[f"{field}, {side.ku:g}, {name}"] = getattr(met.at, field)[order]
    return {name: np.asarray(values, float).tolist() for name, values in found.items()}


def float_box(prims: Any) -> tuple[Any, Any]:
    """Corners of a box around the first primitive, in whose units rays are aimed."""
    if hasattr(prims, "faces"):
        corners = prims.vertices[prims.faces[0]]
        return corners.min(axis=0), corners.max(axis=0)
    if hasattr(prims, "start"):
        ends = np.stack([prims.start[0], prims.end[0]])
        return ends.min(axis=0) - prims.radius[0].max(), ends.max(axis=0) + prims.radius[0].max()
    if not hasattr(prims, "to_world") and not hasattr(prims, "radius"):
        return np.full(3, -np.inf), np.full(3, np.inf)
    reach = np.abs(prims.to_world[0]).sum(axis=1) if hasattr(prims, "to_world") else prims.radius[0]
    return prims.center[0] - reach, prims.center[0] + reach


def packing(shape: Any) -> dict[str, list[float]]:
    """How many packed numbers are expected, whether rounded, and the sums of their magnitudes and of their sizes."""
    found = {}
    for each in expectations(shape, packed(scene_of(shape)).parts[0]):
        expected = np.asarray(each.expected, float)
        assert np.shape(each.packed) == expected.shape and each.packed == pytest.approx(expected, rel=1e-9, abs=1e-9)
        size = np.broadcast_to(each.size, expected.shape)
        found[each.what] = [expected.size, each.rounded, np.abs(expected).sum(), size.sum()]
    return {name: [float(x) for x in row] for name, row in found.items()}


def expectations(shape: Any, part: Any) -> list[Any]:
    return list(reference_of(shape).expected(shape, part))


def roots(shape: Any) -> dict[str, list[float]]:
    """t, its error bound and the sure misses of the caster's kernels, for rays from near and far and of any length."""
    (kind,) = packed(scene_of(shape)).kinds
    found = []
    for start in (*ORIGINS, (-3e5, 2e5, 9e4)):
        pre = prepare(kind.prims, load(kind.prims, 0), start)
        for target in (*TARGETS, *(tuple(4.0 * np.array(target)) for target in TARGETS)):
            for length in (1.0, 2.0**-500, 2.0**490):
                d = tuple(((np.array(target) * 3.0 - np.array(start)) * length).tolist())
                found += [*intersect(kind.prims, pre, d, 0.0, math.inf), float(surely_misses(kind.prims, pre, d))]
    return {"t, error, missed": found}


SURE_HIT, UNDECIDED, SURE_MISS = range(3)
FAR = ((3e5, 1e5, 2e5), (-1e5, 2e4, 3e5), (300.0, -200.0, 90.0))
BESIDE = ((2.5, 0.5, 0.5), (0.5, -1.5, 0.5), (0.5, 0.5, 2.5), (0.5, 0.5, -1.5))  # in boxes of the shape


def doubts(shape: Any) -> dict[str, list[float]]:
    """Where rays that turn from a sure hit to a sure miss stop being sure, and how far they turn in between.

    The width is twice the bounds that decide; from far away it is a billion of the smallest steps.
    """
    (kind,) = packed(scene_of(shape)).kinds
    low, high = box_of(kind.prims)
    found = []
    for start, beside, length in itertools.product(FAR, BESIDE, (1.0, 7.0)):
        o = (low + np.array(start) * (high - low)).tolist()
        pre = prepare(kind.prims, load(kind.prims, 0), tuple(o))

        def answer(part: float, o: Any = o, pre: Any = pre, beside: Any = beside, length: float = length) -> int:
            place = low + ((1.0 - part) * np.array((0.4, 0.45, 0.4)) + part * np.array(beside)) * (high - low)
            x, y, z = place - o
            d = (place - o) * (length / math.sqrt(x * x + y * y + z * z))
            t, error = intersect(kind.prims, pre, tuple(d.tolist()), 0.0, math.inf)
            return UNDECIDED if error == math.inf else SURE_HIT if t < math.inf else SURE_MISS

        if (answer(0.0), answer(1.0)) == (SURE_HIT, SURE_MISS):
            hit = changes_at(lambda part, answer=answer: answer(part) != SURE_HIT)
            found += [hit, changes_at(lambda part, answer=answer: answer(part) == SURE_MISS) - hit]
    return {"end of sure hits, width of doubt": found}


def box_of(prims: Any) -> tuple[np.ndarray, np.ndarray]:
    points = np.array([hull_point(prims, 0, j) for j in range(hull_size(prims))])
    return points.min(axis=0), points.max(axis=0)


def changes_at(test: Callable[[float], bool]) -> float:
    """Where between 0 and 1 a test becomes true, by halving: to the last bit."""
    low, high = 0.0, 1.0
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (low, middle) if test(middle) else (middle, high)
    return high


def coarse(_: Any) -> dict[str, list[float]]:
    """Roots of a sphere from inputs with large errors, where second order counts; least heights of slivers."""
    roots = []
    for f, f_error, d_error in itertools.product(
        ((3.0, 0.5, -0.25), (-1e4, 2e3, 3e3)), (0.0, 1e-3, 0.1), (0.0, 1e-3, 0.05)
    ):
        for d in ((-1.0, -0.2, 0.1), (0.5, -0.1, -0.15), (-3.0, -0.5, 0.5)):
            roots += [float(x) for x in quadric_roots(quadric_setup(f, 1.5, f_error), d, d_error)]
    heights = []
    for far, axis in itertools.product((1.0, 2.0**12), range(3)):

        def is_known(part: float, far: float = far, axis: int = axis) -> bool:
            flat = ((-8.0, 0.0), (1.0, part * 2.0**-30), (0.5, 0.0))
            corners = [tuple(np.roll((x + far / 64.0, y, far), axis).tolist()) for x, y in flat]
            return bool(fast_barycentrics(*corners, tuple(np.roll((1.0 / 64.0, 0.0, 1.0), axis).tolist()))[0])

        heights.append(changes_at(is_known))
    return {"roots": roots, "slivers with barycentrics": heights}


TABLES: dict[str, tuple[Callable[[Any], dict[str, Any]], dict[str, Any]]] = {
    "bounds": (bounds, SHAPES),
    "packing": (packing, PACKED_SHAPES),
    "roots": (roots, SHAPES),
    "coarse": (coarse, {"all": None}),
    "doubts": (doubts, {name: shape for name, shape in SHAPES.items() if name != "plane"}),
}


def stated(table: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))[table]
    return found


def differences(found: dict[str, list[float]], expected: dict[str, list[float]]) -> Iterator[str]:
    """The names of the numbers that are not the stated ones, up to the last bits."""
    assert list(found) == list(expected)
    for name, numbers in expected.items():
        if found[name] != pytest.approx([float(x) for x in numbers], rel=1e-8, abs=0.0, nan_ok=True):
            yield name


@pytest.mark.parametrize(("table", "name"), [(table, name) for table, (_, cases) in TABLES.items() for name in cases])
def test_numbers_are_the_stated_ones(table, name):
    compute, cases = TABLES[table]
    with np.errstate(all="ignore"):  # kernels in plain Python
        found = compute(cases[name])
    assert not list(differences(found, stated(table)[name]))


def test_constants_are_the_stated_ones():
    assert not list(differences(constants(), stated("constants")))


OF_PACKED_NUMBERS = {"generated normals", "handedness"}  # compared with other numbers that are packed with them


@pytest.mark.parametrize("name", PACKED_SHAPES)
def test_expected_numbers_and_sizes_do_not_depend_on_what_was_packed(name):
    """Otherwise an infinite packed number would get an infinite bound, and pass."""
    shape = PACKED_SHAPES[name]
    part = packed(scene_of(shape)).parts[0]
    spoiled = type(part)(*(array * 3 + 7 if array.dtype.kind == "f" else array for array in part))
    for one, other in zip(expectations(shape, part), expectations(shape, spoiled), strict=True):
        same = np.array_equal(one.expected, other.expected) and np.array_equal(one.size, other.size)
        assert one.what == other.what and (same or one.what in OF_PACKED_NUMBERS), one.what


if __name__ == "__main__":
    tables: dict[str, Any] = {"constants": constants()}
    with np.errstate(all="ignore"):
        for table, (compute, cases) in TABLES.items():
            tables[table] = {name: compute(case) for name, case in cases.items()}
    short = json.loads(json.dumps(tables), parse_float=lambda x: float(f"{float(x):.12g}"))
    FILE.write_text(json.dumps(short).replace('], "', '],\n "') + "\n", encoding="utf-8")

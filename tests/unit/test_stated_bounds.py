"""Bounds of the error model, number by number, for a few rays at each kind of primitive.

That bounds are no smaller than the errors there are is held by exact arithmetic (test_error_models.py,
tests/reference/test_error_models_hold.py); a larger one would excuse more, and nothing would fail. So the numbers stand
in stated_bounds.json, and one that changes shows in its diff; `python tests/unit/test_stated_bounds.py` writes it anew.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import caster
from caster.geometry.packing import packed as make_packed
from caster.scene.model import Scene
from mitsuba_ref.error_model.tolerances import KU, KU_OURS
from mitsuba_ref.reference.shared_input import SharedRays, model_of, packed_float32
from mitsuba_ref.shapes import reference_of

STATED = Path(__file__).with_name("stated_bounds.json")
TURN = {"rotate": {"axis": [1, 2, 3], "degrees": 37}}
STRETCH = {"matrix": [[2, 0.5, 0, 1], [0, 0.75, 0.25, 2], [0.125, 0, 1.5, 3], [0, 0, 0, 1]]}
CORNERS = ((0.0, 0.0, 0.5), (4.0, 0.25, 0.0), (0.5, 3.0, 1.0))
NORMALS = ((0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.0, 0.6, 0.8))
UV = ((0.0, 0.25), (2.0, 0.0), (0.5, 1.0))
MOVED = {"translate": [10, 20, 30]}
SHAPES = {
    "sphere": caster.Sphere(center=(1, 2, 3), radius=1.5),
    "ellipsoid": caster.Sphere(to_world=[STRETCH]),
    "disk": caster.Disk(to_world=[TURN, MOVED]),
    "stretched disk": caster.Disk(to_world=[STRETCH]),
    "cylinder": caster.Cylinder(to_world=[TURN, {"scale": 2}]),
    "stretched cylinder": caster.Cylinder(to_world=[STRETCH]),
    "plane": caster.Plane(point=(1, 2, 3), normal=(1, 2, 4)),
    "triangle": caster.Triangle(vertices=CORNERS),
    "smooth triangle": caster.Triangle(vertices=CORNERS, normals=NORMALS, uv=UV),
    "far triangle": caster.Triangle(vertices=CORNERS, to_world=[MOVED]),
}
# Packed numbers and generated meshes are expected from their descriptions, with the sizes of what was rounded.
PLACE = [{"scale": 2}, TURN, MOVED]
PACKED_SHAPES = {
    "sphere": caster.Sphere(center=(1, 2, 3), radius=1.5, to_world=PLACE),
    "ellipsoid": caster.Sphere(center=(1, 2, 3), radius=1.5, to_world=[STRETCH]),
    "cloud": caster.SphereCloud(centers=((1, 2, 3), (0.5, -1, 4)), radii=(0.5, 0.25), to_world=PLACE),
    "stretched cloud": caster.SphereCloud(centers=((1, 2, 3), (0.5, -1, 4)), radius=0.75, to_world=[STRETCH]),
    "disk": caster.Disk(to_world=PLACE),
    "cylinder": caster.Cylinder(to_world=[STRETCH]),
    "long cylinder": caster.Cylinder(p0=(1, 2, 3), p1=(2, -1, 6), radius=0.5, to_world=PLACE),
    "plane": caster.Plane(point=(1, 2, 3), normal=(1, 2, 4), to_world=PLACE),
    "triangle": caster.Triangle(vertices=CORNERS, normals=NORMALS, uv=UV, to_world=PLACE),
    "cube": caster.Cube(to_world=[STRETCH]),
    "rectangle": caster.Rectangle(to_world=[STRETCH]),
    "torus": caster.Torus(segments=5, sides=4, to_world=PLACE),
    "icosphere": caster.Icosphere(subdivisions=1, to_world=[STRETCH]),
    "heightfield": caster.Heightfield(resolution=4, to_world=PLACE),
    "thin torus": caster.Torus(segments=4, sides=3, major_radius=3.0, minor_radius=0.125),
    "steep heightfield": caster.Heightfield(resolution=2, size=5.0, amplitude=2.0, waves=3, seed=4),
    "teapot": caster.Teapot(subdivisions=2, to_world=PLACE),
}
TARGETS = [(0.5, 0.5, 0.5), (0.1, 0.6, 0.4), (0.9, 0.2, 0.7), (0.0, 0.5, 0.5), (0.3, 0.3, 0.35), (1.0, 1.0, 0.2)]
ORIGINS = [(7.0, 3.0, 5.0), (0.25, -9.0, -40.0)]
SIDES = [
    ("reference", KU, False),
    ("ours", KU_OURS, True),
    ("reference, coarse", 2.0**-6, False),
    ("ours, coarse", 2.0**-6, True),
]


def bounds_of(name: str) -> dict[str, Any]:
    """Every number of the meetings of some rays with a shape, for either side's roundings, and for coarse ones.

    Of roundings of 1/64, terms of second order are seen, and where an error has no bound any more.
    """
    camera = caster.Pinhole(eye=(0, 0, 9), look_at=(0, 0, 0))
    scene = Scene(film=caster.Film(width=2, height=2), camera=camera, shapes=[SHAPES[name]])
    packed = packed_float32(scene)
    none = np.zeros((1, 3), np.float32)
    model = model_of(scene, packed, SharedRays(none, none + 1, np.full(1, np.inf, np.float32), np.zeros(1)))
    low, high = (np.clip(corner[0], -5.0, 40.0) for corner in model.boxes)
    targets = low + np.array(TARGETS) * (high - low)
    o = np.repeat(np.array(ORIGINS) + low, len(TARGETS), axis=0).astype(np.float32).astype(float)
    d = ((np.tile(targets, (len(ORIGINS), 1)) - o) * 0.75).astype(np.float32).astype(float)
    found: dict[str, Any] = {}
    for side, ku, ours in SIDES:
        met = model.intersect(np.zeros(len(o), np.int64), o, d, ku, ours=ours)
        order = np.lexsort([np.nan_to_num(met.at.t), met.pair])
        fields = {field: np.asarray(value)[order] for field, value in met.at._asdict().items() if value is not None}
        found[side] = {"pair": met.pair[order].tolist()} | {
            field: np.asarray(value, float).reshape(len(order), -1).tolist() for field, value in fields.items()
        }
    return found


def expectations_of(name: str) -> dict[str, list[Any]]:
    """What is expected of a shape's numbers: how many, whether rounded, their sum of magnitudes, and of their sizes."""
    shape = PACKED_SHAPES[name]
    camera = caster.Pinhole(eye=(0, 0, 9), look_at=(0, 0, 0))
    scene = Scene(film=caster.Film(width=2, height=2), camera=camera, shapes=[shape])
    reference = reference_of(shape)
    found: dict[str, list[Any]] = {}
    for each in reference.expected(shape, make_packed(scene).parts[0]):
        expected = np.asarray(each.expected, float)
        size = np.broadcast_to(each.size, expected.shape)
        assert np.shape(each.packed) == expected.shape and each.packed == pytest.approx(expected, rel=1e-9, abs=1e-9)
        found[each.what] = [expected.size, bool(each.rounded), float(np.abs(expected).sum()), float(size.sum())]
    return found


def as_stated(found: dict[str, Any]) -> dict[str, Any]:
    return {
        side: {field: [[float(f"{x:.7g}") for x in row] if isinstance(row, list) else row for row in rows]
               for field, rows in fields.items()}
        for side, fields in found.items()
    }  # fmt: skip


@pytest.mark.parametrize("name", SHAPES)
def test_bounds_are_the_stated_numbers(name):
    stated = json.loads(STATED.read_text(encoding="utf-8"))[name]
    found = bounds_of(name)
    for side, fields in stated.items():
        assert list(fields) == list(found[side])
        for field, rows in fields.items():
            expected, values = np.array(rows, float), np.array(found[side][field], float)
            size = np.abs(expected[np.isfinite(expected)]).max(initial=0.0)
            least = 0.0 if "error" in field else 1e-9 * size
            assert values == pytest.approx(expected, rel=1e-6, abs=least, nan_ok=True), (side, field)


@pytest.mark.parametrize("name", PACKED_SHAPES)
def test_expected_numbers_and_their_sizes_are_stated(name):
    stated, found = json.loads(STATED.read_text(encoding="utf-8"))["packing"][name], expectations_of(name)
    assert {what: row[:2] for what, row in found.items()} == {what: row[:2] for what, row in stated.items()}
    for what, row in stated.items():
        assert found[what][2:] == pytest.approx(row[2:], rel=1e-6), what


OF_PACKED_NUMBERS = {"generated normals", "handedness"}  # held to other numbers that are packed with them


@pytest.mark.parametrize("name", PACKED_SHAPES)
def test_what_is_expected_and_its_size_do_not_depend_on_what_was_packed(name):
    """An infinite or large number in its place would else have an infinite or large bound."""
    shape = PACKED_SHAPES[name]
    scene = Scene(
        film=caster.Film(width=2, height=2), camera=caster.Pinhole(eye=(0, 0, 9), look_at=(0, 0, 0)), shapes=[shape]
    )
    part, reference = make_packed(scene).parts[0], reference_of(shape)
    spoiled = type(part)(*(array * 3 + 7 if array.dtype.kind == "f" else array for array in part))
    right, wrong = (list(reference.expected(shape, each)) for each in (part, spoiled))
    assert [each.what for each in right] == [each.what for each in wrong]
    changed = 0
    for one, other in zip(right, wrong, strict=True):
        if one.what not in OF_PACKED_NUMBERS:
            assert np.array_equal(one.expected, other.expected) and np.array_equal(one.size, other.size), one.what
            changed += not np.array_equal(one.packed, other.packed)
    floats = sum(array.dtype.kind == "f" and array.size > 0 for array in part)
    assert 0 < changed <= floats + 2


def test_every_kind_has_stated_numbers():
    assert set(json.loads(STATED.read_text(encoding="utf-8"))) == {*SHAPES, "packing"}
    hits = [sum(map(sum, bounds_of(name)["reference"]["possible"])) for name in SHAPES]
    assert min(hits) >= 1


if __name__ == "__main__":
    numbers: dict[str, Any] = {name: as_stated(bounds_of(name)) for name in SHAPES}
    numbers["packing"] = {name: expectations_of(name) for name in PACKED_SHAPES}
    STATED.write_text(json.dumps(numbers) + "\n", encoding="utf-8")

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
from caster.scene.model import Scene
from mitsuba_ref.error_model.tolerances import KU, KU_OURS
from mitsuba_ref.reference.shared_input import SharedRays, model_of, packed_float32

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
TARGETS = [
    (0.5, 0.5, 0.5),
    (0.1, 0.6, 0.4),
    (0.9, 0.2, 0.7),
    (0.0, 0.5, 0.5),
    (0.3, 0.3, 0.35),
    (1.0, 1.0, 0.2),
]
ORIGINS = [(7.0, 3.0, 5.0), (0.25, -9.0, -40.0)]


def bounds_of(name: str) -> dict[str, Any]:
    """Every number of the meetings of some rays with a shape, for either side's roundings."""
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
    for side, ku, ours in (("reference", KU, False), ("ours", KU_OURS, True)):
        met = model.intersect(np.zeros(len(o), np.int64), o, d, ku, ours=ours)
        order = np.lexsort([np.nan_to_num(met.at.t), met.pair])
        fields = {
            field: np.asarray(value)[order] for field, value in met.at._asdict().items() if value is not None
        }
        found[side] = {"pair": met.pair[order].tolist()} | {
            field: np.asarray(value, float).reshape(len(order), -1).tolist()
            for field, value in fields.items()
        }
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


def test_every_kind_has_stated_numbers():
    assert set(json.loads(STATED.read_text(encoding="utf-8"))) == set(SHAPES)
    hits = [sum(map(sum, bounds_of(name)["reference"]["possible"])) for name in SHAPES]
    assert min(hits) >= 1


if __name__ == "__main__":
    STATED.write_text(
        json.dumps({name: as_stated(bounds_of(name)) for name in SHAPES}) + "\n", encoding="utf-8"
    )

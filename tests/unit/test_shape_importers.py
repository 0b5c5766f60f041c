"""Importers of Mitsuba's shapes: fields, and notes on properties that are not kept."""

from typing import Any

import numpy as np
import pytest

from mitsuba_ref.error_model.independent_transform import compose_transform
from mitsuba_ref.shapes import REFERENCES

IMPORTERS = {name: each for reference in REFERENCES.values() for name, each in reference.importers.items()}
TURN = {"rotate": {"axis": [0.0, 0.0, 1.0], "degrees": 90.0}}
MOVE, DOUBLE, MIRROR = {"translate": [1.0, 2.0, 3.0]}, {"scale": [2.0, 2.0, 2.0]}, {"scale": [1.0, 1.0, -1.0]}
STRETCH = {"scale": [3.0, 1.0, 2.0]}
INWARD = "its normal, which points inwards: normals point outwards here"
FLIPPED = "flip_normals: the normal is not flipped here"
MIRRORED = "the side of its normal: Mitsuba's mirrored geometric and shading normals point to different sides"
IGNORED = "the non-uniform scale, which Mitsuba ignores as well: the radius is that along x"


class Element:
    """A <shape> with these properties and steps."""

    def __init__(self, properties: dict[str, Any], steps: list[Any], instanced: bool) -> None:
        self.properties, self.steps, self.instanced, self.notes = properties, steps, instanced, []

    @property
    def matrix(self) -> np.ndarray | None:
        if not self.steps:
            return None
        shape = next(each for each in REFERENCES if each.__name__ == "Disk")(to_world=self.steps)
        return compose_transform(shape.to_world)

    def number(self, name: str, default: float) -> float:
        return self.properties.get(name, default)

    def vector(self, name: str, default: tuple[float, ...]) -> list[float]:
        return list(self.properties.get(name, default))

    def boolean(self, name: str) -> bool:
        return self.properties.get(name, False)

    def required_text(self, name: str) -> str:
        return self.properties[name]

    def note(self, text: str) -> None:
        self.notes.append(text)


def imported(name: str, *steps: Any, instanced: bool = False, **properties: Any) -> tuple[dict[str, Any], list[str]]:
    element = Element(properties, list(steps), instanced)
    return IMPORTERS[name](element), element.notes


def test_these_shapes_of_mitsubas_are_imported():
    assert set(IMPORTERS) == {"sphere", "disk", "cylinder", "rectangle", "cube", "obj", "ply"}


@pytest.mark.parametrize(
    ("steps", "properties", "center", "radius", "notes"),
    [
        ((), {}, (0, 0, 0), 1.0, []),
        ((), {"center": (1, 2, 3), "radius": 4.0}, (1, 2, 3), 4.0, []),
        ((), {"radius": -4.0}, (0, 0, 0), 4.0, [INWARD]),
        ((), {"flip_normals": True}, (0, 0, 0), 1.0, [INWARD]),
        ((), {"flip_normals": True, "radius": -1.0}, (0, 0, 0), 1.0, []),
        ((DOUBLE, MOVE), {"center": (1, 0, 0), "radius": 3.0}, (3, 2, 3), 6.0, []),
        ((TURN, MOVE), {"center": (1, 0, 0)}, (1, 3, 3), 1.0, []),
        ((MIRROR,), {"center": (0, 0, 5)}, (0, 0, -5), 1.0, [INWARD]),
        ((MIRROR,), {"flip_normals": True}, (0, 0, 0), 1.0, []),
        ((STRETCH,), {"center": (1, 1, 1), "radius": 0.5}, (3, 1, 2), 1.5, [IGNORED]),
        ((STRETCH,), {"flip_normals": True}, (0, 0, 0), 3.0, [INWARD, IGNORED]),
    ],
)
def test_a_sphere_is_one_of_the_center_and_radius_that_its_matrix_gives(steps, properties, center, radius, notes):
    fields, found = imported("sphere", *steps, **properties)
    assert set(fields) == {"type", "center", "radius"} and fields["type"] == "sphere" and found == notes
    assert fields["center"] == pytest.approx(center, abs=1e-15) and fields["radius"] == pytest.approx(radius)


def test_a_scale_is_uniform_up_to_eight_roundings_of_float32():
    for off, notes in ((7.9, []), (8.1, [IGNORED])):
        for size in (1.0, 2.0**10, 2.0**-10):
            assert imported("sphere", {"scale": [size, size * (1.0 - off / 2**24), size]})[1] == notes


def test_an_instance_stretches_its_sphere_and_keeps_the_side_of_its_normal():
    fields, notes = imported("sphere", STRETCH, MIRROR, instanced=True, center=(1, 2, 3), radius=2.0)
    assert fields == {"type": "sphere", "center": [1, 2, 3], "radius": 2.0, "to_world": [STRETCH, MIRROR]}
    assert notes == [] and imported("sphere", MIRROR, instanced=True, flip_normals=True)[1] == [INWARD]
    assert imported("sphere", instanced=True)[0] == {"type": "sphere", "center": [0.0] * 3, "radius": 1.0}


def test_a_cylinder_has_its_ends_and_radius_and_a_note_where_it_faces_inwards():
    assert imported("cylinder") == (
        {"type": "cylinder", "p0": [0.0, 0.0, 0.0], "p1": [0.0, 0.0, 1.0], "radius": 1.0},
        [],
    )
    given = {"p0": (1, 2, 3), "p1": (4, 5, 6), "radius": 0.5}
    fields, notes = imported("cylinder", TURN, flip_normals=True, **given)
    assert fields == {"type": "cylinder", "p0": [1, 2, 3], "p1": [4, 5, 6], "radius": 0.5, "to_world": [TURN]}
    assert notes == [INWARD]


@pytest.mark.parametrize("name", ["disk", "rectangle", "cube"])
def test_a_unit_shape_has_the_steps_alone_and_a_note_on_the_side_of_its_normal(name):
    assert imported(name) == ({"type": name}, [])
    assert imported(name, TURN, MOVE) == ({"type": name, "to_world": [TURN, MOVE]}, [])
    assert imported(name, MIRROR, TURN) == ({"type": name, "to_world": [MIRROR, TURN]}, [MIRRORED])
    fields, notes = imported(name, TURN, flip_normals=True)
    if name == "disk":  # turned over, which is the same disk with its normal on the other side
        assert (fields, notes) == ({"type": "disk", "to_world": [{"scale": [1.0, 1.0, -1.0]}, TURN]}, [])
    else:
        assert (fields, notes) == ({"type": name, "to_world": [TURN]}, [FLIPPED])
        assert imported(name, MIRROR, flip_normals=True)[1] == [FLIPPED]


@pytest.mark.parametrize("name", ["obj", "ply"])
def test_a_mesh_has_its_file_and_whether_it_is_flat(name):
    assert imported(name, filename="a.mesh") == ({"type": "mesh", "file": "a.mesh"}, [])
    flat = {"type": "mesh", "file": "b", "face_normals": True, "to_world": [MOVE]}
    assert imported(name, MOVE, filename="b", face_normals=True) == (flat, [])
    assert imported(name, filename="b", flip_normals=True)[1] == [FLIPPED]
    assert imported(name, MIRROR, filename="b")[1] == [MIRRORED]

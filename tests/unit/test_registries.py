"""Every registered shape and camera has a reference, and every AOV a check."""

from types import SimpleNamespace

import pytest

from caster.aovs import AOVS
from caster.cameras import CAMERAS
from caster.description.fields import Shape
from caster.geometry.packing import pack, pack_shape, rejected_faces
from caster.geometry.world_space import as_given
from caster.scene.model import Film, Scene
from caster.shapes import SHAPES, Rectangle
from mitsuba_ref import cameras, shapes
from mitsuba_ref.scene_xml.elements import missing_reference
from mitsuba_ref.shapes import reference_of
from mitsuba_ref.subjects.subject import COMPARED_AOVS

# AOVs that are not compared with the reference, and why; they have to follow from our own hits (coherence.py).
NOT_COMPARED = {
    "prim_id": "triangles of one edge may both be right, so the shape is compared, and the surface hit",
    "albedo": "diffuse holds it: reflectance times light",
}
SEEN_THROUGH = {"hit": "mask"}  # AOV -> the check it goes by


@pytest.mark.parametrize(
    ("described", "registered", "folder"),
    [(shapes.REFERENCES, SHAPES, "shapes"), (cameras.REFERENCES, CAMERAS, "cameras")],
    ids=["shapes", "cameras"],
)
def test_every_kind_has_exactly_one_reference(described, registered, folder):
    for kind in registered:
        assert list(described).count(kind) == 1, missing_reference(kind.__name__, folder)
    assert len(described) == len(registered), f"a reference without its class in caster/{folder}/__init__.py"


def test_every_aov_is_compared_or_listed_as_not_compared():
    for aov in AOVS:
        assert (aov.NAME in COMPARED_AOVS or aov.NAME in SEEN_THROUGH) != (aov.NAME in NOT_COMPARED), (
            f"{aov.NAME}: add its bound to allowed_distance in mitsuba_ref/judge/comparison.py and its name to "
            "COMPARED_AOVS in mitsuba_ref/subjects/subject.py, or say in NOT_COMPARED why it is not compared"
        )
    assert {*COMPARED_AOVS, *SEEN_THROUGH, *NOT_COMPARED} == {aov.NAME for aov in AOVS}


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda cls: cls.__name__)
def test_the_least_description_of_a_camera_and_of_each_shape_is_rendered(camera):
    """One without a face that is never hit: kernels are compiled ahead for these."""
    own = [shape(**shape.MINIMAL) for shape in SHAPES if "file" not in shape.model_fields]
    for shape in own:
        scene = Scene(camera=camera(**camera.MINIMAL), film=Film(width=2, height=2), shapes=[shape])
        assert sum(len(kind.ids) for kind in pack(scene).kinds) > 0 and rejected_faces(scene) == {}
    assert len(own) > 8


@pytest.mark.parametrize(("field", "rows"), [("normals", 4), ("uv", 4), ("smooth", 2), ("textured", 2)])
def test_a_mesh_with_arrays_of_other_lengths_is_a_mistake_of_its_shape(field, rows):
    """Kernels read normals and uv of every vertex, whether they are used or not."""

    class Short(Rectangle):
        def pack(self, rounded):
            part = super().pack(rounded)
            return part._replace(**{field: getattr(part, field)[:-1]})

    collection = SimpleNamespace(shapes=[Short()])
    with pytest.raises(ValueError, match=rf"^Short\.pack: {field} must have {rows} rows, got {rows - 1}; fill up"):
        pack_shape(collection, 0, as_given)


def test_a_shape_without_a_reference_names_what_to_write():
    class Cone(Shape):
        type: str = "cone"

    with pytest.raises(LookupError) as error:
        reference_of(Cone())
    said = str(error.value)
    assert said.startswith("Cone has no reference: write mitsuba_ref/shapes/cone.py and add its line to ")
    assert "mitsuba_ref/shapes/__init__.py" in said

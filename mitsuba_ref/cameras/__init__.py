"""Registry of the judge's side of cameras: one entry for every camera of caster.cameras.CAMERAS.

A plug-in (mitsuba_ref/shapes/__init__.py) adds a camera by `register`.
"""

from caster.description.fields import Camera, Description
from mitsuba_ref.cameras import references
from mitsuba_ref.cameras.camera_reference import CameraReference, ClipRange
from mitsuba_ref.scene_xml.elements import MissingReferenceError, missing_reference

__all__ = ["REFERENCES", "ClipRange", "reference_of_camera", "register"]

REFERENCES: dict[type[Description], CameraReference] = {}


def register(reference: CameraReference) -> None:
    """Add a camera; a second entry for a camera replaces the first."""
    REFERENCES[reference.describes] = reference


def reference_of_camera(camera: Camera) -> CameraReference:
    """The entry of a camera. Raises MissingReferenceError, saying what to write, if there is none."""
    if type(camera) not in REFERENCES:
        raise MissingReferenceError(missing_reference(type(camera).__name__, "cameras"))
    return REFERENCES[type(camera)]


for _reference in (
    references.PINHOLE,
    references.ORTHOGRAPHIC,
    references.FISHEYE,
    references.PANORAMA,
    references.RAY,
):
    register(_reference)

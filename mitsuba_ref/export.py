"""A scene as Mitsuba loads it: every shape by its reference, the camera by its own."""

import numpy as np

from caster.fields import Camera
from caster.packing import pack
from caster.placing import as_float32
from caster.scene import Scene
from mitsuba_ref.camera_reference import CameraReference, Limits
from mitsuba_ref.cameras import REFERENCES
from mitsuba_ref.model import MissingReferenceError, Model, missing_reference, model_of, reference_of
from mitsuba_ref.rays import share
from mitsuba_ref.xml import Export, Writer, to_text

OF_CAMERA = {reference.describes: reference for reference in REFERENCES}

# Where a sensor's clip planes go when the scene has none, in units of how far the scene reaches.
NEAR, FAR = 2.0**-20, 2.0**10


def camera_reference(camera: Camera) -> CameraReference:
    """Raises MissingReferenceError with what to write, where a camera has no reference yet."""
    if type(camera) not in OF_CAMERA:
        raise MissingReferenceError(missing_reference(type(camera).__name__, "cameras"))
    return OF_CAMERA[type(camera)]


def export_scene(scene: Scene) -> Export:
    """Scene -> XML and meshes, for plain Mitsuba."""
    return export(scene, model_of(scene, pack(scene, as_float32), share(scene)))


def export(scene: Scene, model: Model, *, robust: bool = True) -> Export:
    """The same, of geometry that is packed already. robust: Embree's mode that keeps meshes closed."""
    out = Writer(scene)
    shapes = []
    for name, shape, part in zip(shape_ids(scene), scene.shapes, model.parts, strict=True):
        out.name = name
        shapes += reference_of(shape).to_xml(out, shape, part)
    sensor = camera_reference(scene.camera).to_xml(scene.camera, scene.film, limits(scene, model))
    if sensor is None:
        out.notes.append(f"no sensor: Mitsuba has no {scene.camera.type} camera, so rays are handed over")
    text = to_text(scene, shapes, sensor, out, robust=robust)
    return Export(text, out.meshes, shape_ids(scene), out.notes)


def shape_ids(scene: Scene) -> list[str]:
    """One id per shape: its name, unless Mitsuba would read a parameter in it."""
    return [f"shapes[{i}]" if "$" in name else name for i, name in enumerate(scene.shape_names())]


def limits(scene: Scene, model: Model) -> Limits:
    """Clip planes that cut nothing off: by the farthest corner of what has an end, and the eye."""
    corners = np.abs(np.concatenate(model.boxes))
    ends = corners[np.isfinite(corners)]
    reach = float(max(ends.max(initial=0.0), np.abs(scene.camera.eye).max(), 1e-3))
    return Limits(NEAR * reach, FAR * reach)

"""The registry of shapes and primitive kinds on the judge's side: one entry for every shape of caster.shapes.SHAPES.

A plug-in is a module that calls `register`. Programs import it; the commands also load every module that an installed
distribution names as an entry point of the group "mitsuba_ref.plugins".
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from caster.description.fields import Shape
from caster.description.registry import load_plugins
from caster.geometry.packing import Packed, concatenate_parts
from caster.scene.model import Scene
from mitsuba_ref.error_model.intersections import ErrorModel
from mitsuba_ref.error_model.scene_model import SceneModel
from mitsuba_ref.reference.rays import SharedRays
from mitsuba_ref.reference.xml_writer import MissingReferenceError, missing_reference
from mitsuba_ref.shapes import cylinder, disk, plane, sphere, triangle_meshes
from mitsuba_ref.shapes.shape_reference import PrimitiveReference, ShapeReference

__all__ = ["KINDS", "REFERENCES", "kind_of", "model_of", "reference_of", "register"]

REFERENCES: dict[type[Shape], ShapeReference] = {}
KINDS: dict[type[Any], PrimitiveReference] = {}  # by the class of their arrays


def register(reference: ShapeReference) -> None:
    """Add a shape and its kinds; a second reference of a shape takes the place of the first."""
    REFERENCES[reference.describes] = reference
    KINDS.update({kind.arrays: kind for kind in reference.kinds})


def kind_of(part: Any) -> PrimitiveReference:
    """The kind of packed arrays. Raises LookupError with what to write, where nothing is registered."""
    if type(part) not in KINDS:
        raise LookupError(
            f"{type(part).__name__}: no primitive kind of that name is registered in mitsuba_ref.shapes "
            "(docs/adding-a-shape.md)"
        )
    return KINDS[type(part)]


def reference_of(shape: Shape) -> ShapeReference:
    """Raises MissingReferenceError with what to write, where a shape has no reference yet."""
    if type(shape) not in REFERENCES:
        raise MissingReferenceError(missing_reference(type(shape).__name__, "shapes"))
    return REFERENCES[type(shape)]


def model_of(scene: Scene, packed: Packed, rays: SharedRays) -> SceneModel:
    """The judge's view of packed float32 geometry; stand-ins are cut to these rays."""
    references = [reference_of(shape) for shape in scene.shapes]
    real = rays.t_max >= 0.0
    o, d = rays.o[real].astype(np.float64), rays.d[real].astype(np.float64)
    parts = tuple(
        reference.stand_in(part, o, d) for reference, part in zip(references, packed.parts, strict=True)
    )
    members = [np.flatnonzero(packed.kind_of == place) for place in range(len(packed.kinds))]
    kinds = tuple(concatenate_parts([parts[s] for s in shapes]) for shapes in members)
    models = tuple(_model(references, packed, shapes) for shapes in members)
    return SceneModel(packed, parts, kinds, models)


def _model(references: Sequence[ShapeReference], packed: Packed, shapes: np.ndarray) -> ErrorModel:
    first = int(shapes[0])
    return references[first].model_of(packed.parts[first])


for _reference in (
    sphere.REFERENCE,
    plane.REFERENCE,
    triangle_meshes.TRIANGLE,
    triangle_meshes.MESH,
    triangle_meshes.RECTANGLE,
    disk.REFERENCE,
    triangle_meshes.CUBE,
    cylinder.REFERENCE,
    triangle_meshes.ICOSPHERE,
    triangle_meshes.TORUS,
    triangle_meshes.HEIGHTFIELD,
    triangle_meshes.TEAPOT,
):
    register(_reference)
load_plugins("mitsuba_ref.plugins")

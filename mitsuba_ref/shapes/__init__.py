"""Registry of the judge's side of shapes and primitive kinds: one entry for every shape of caster.shapes.SHAPES.

A plug-in is a module that calls `register`. Programs import it; the commands also load every module that an installed
distribution names as an entry point of the group "mitsuba_ref.plugins".
"""

from typing import Any

from caster.description.fields import Shape
from caster.description.registry import load_plugins
from mitsuba_ref.oracle.interface import EXACT_KINDS
from mitsuba_ref.scene_xml.elements import MissingReferenceError, missing_reference
from mitsuba_ref.shapes import cylinder, disk, linear_curve, plane, sphere, triangle_meshes
from mitsuba_ref.shapes.shape_reference import PrimitiveReference, ShapeReference

__all__ = ["KINDS", "REFERENCES", "kind_of", "reference_of", "register"]

REFERENCES: dict[type[Shape], ShapeReference] = {}
KINDS: dict[type[Any], PrimitiveReference] = {}  # by the class of their arrays


def register(reference: ShapeReference) -> None:
    """Add a shape and its kinds; a second entry for a shape replaces the first."""
    REFERENCES[reference.describes] = reference
    for kind in reference.kinds:
        KINDS[kind.arrays] = kind
        EXACT_KINDS[kind.arrays] = kind.model.exact


def kind_of(part: Any) -> PrimitiveReference:
    """The kind of packed arrays. Raises LookupError, saying what to write, if it is not registered."""
    if type(part) not in KINDS:
        raise LookupError(
            f"{type(part).__name__}: no primitive kind of that name is registered in mitsuba_ref.shapes "
            "(mitsuba-ref docs adding-a-shape)"
        )
    return KINDS[type(part)]


def reference_of(shape: Shape) -> ShapeReference:
    """The entry of a shape. Raises MissingReferenceError, saying what to write, if there is none."""
    for described in type(shape).__mro__:
        if described in REFERENCES:
            return REFERENCES[described]
    raise MissingReferenceError(missing_reference(type(shape).__name__, "shapes"))


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
    sphere.CLOUD,
    sphere.ELLIPSOID_CLOUD,
    linear_curve.REFERENCE,
):
    register(_reference)
load_plugins("mitsuba_ref.plugins")

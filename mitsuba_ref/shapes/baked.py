"""Shapes that both sides trace as the same triangles, in world space and in float32."""

from typing import Any

from caster.fields import Shape
from caster.packing import Triangles
from caster.placing import is_mirrored
from mitsuba_ref.shape_reference import ShapeReference
from mitsuba_ref.shapes.triangles import MODEL
from mitsuba_ref.xml import Writer, XmlElement


def baked(describes: type[Shape]) -> ShapeReference:
    """A shape of triangles that goes to Mitsuba as a PLY file."""
    return ShapeReference(describes, mesh_to_xml, {Triangles: MODEL})


def native(describes: type[Shape], plugin: str) -> ShapeReference:
    """A shape of triangles that is a plugin of Mitsuba's.

    A mirrored one is baked: there, Mitsuba's geometric normal turns inwards and its shading normal stays outside.
    """

    def to_xml(out: Writer, shape: Any, part: Any) -> list[XmlElement]:
        if is_mirrored(shape.matrix):
            return mesh_to_xml(out, shape, part)
        return [out.native(shape, plugin, shape.matrix[:3, 3], shape.matrix[:3, :3])]

    return ShapeReference(describes, to_xml, {Triangles: MODEL})


def mesh_to_xml(out: Writer, shape: Any, part: Any) -> list[XmlElement]:
    return [out.mesh(shape, part)]

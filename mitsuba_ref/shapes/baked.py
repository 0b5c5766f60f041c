"""Shapes that both sides trace as the same triangles, in world space and in float32.

Mitsuba's own rectangle and cube are among them: they would take their shading normals from the matrix, ours come of
the float32 corners, and far from the origin the two differ; mirrored, their geometric normals would turn inwards.
"""

from typing import Any

from caster.fields import Shape
from caster.packing import Triangles
from mitsuba_ref.placed import Placed, mesh
from mitsuba_ref.shape_reference import ShapeReference
from mitsuba_ref.shapes.triangles import MODEL
from mitsuba_ref.xml import Writer, XmlElement


def baked(describes: type[Shape], placed: Placed = mesh) -> ShapeReference:
    """A shape of triangles that goes to Mitsuba as a PLY file."""
    return ShapeReference(describes, mesh_to_xml, {Triangles: MODEL}, placed)


def mesh_to_xml(out: Writer, shape: Any, part: Any) -> list[XmlElement]:
    return [out.mesh(shape, part)]

"""Shapes that both sides trace as the same triangles, in world space and in float32.

Mitsuba's own rectangle and cube are among them: they would take their shading normals from the matrix, ours come of
the float32 corners, and far from the origin the two differ; mirrored, their geometric normals would turn inwards.
"""

from typing import Any

from caster.description.fields import Shape
from caster.geometry.packing import Triangles
from caster.shapes.cube import Cube
from caster.shapes.heightfield import Heightfield
from caster.shapes.icosphere import Icosphere
from caster.shapes.mesh import MeshFile
from caster.shapes.rectangle import Rectangle
from caster.shapes.teapot import Teapot
from caster.shapes.torus import Torus
from caster.shapes.triangle import Triangle
from mitsuba_ref.error_model.independent_transform import (
    ExpectedPacking,
    expected_cube,
    expected_mesh,
    expected_rectangle,
    expected_triangle,
)
from mitsuba_ref.reference.xml_writer import ShapeWriter, XmlElement
from mitsuba_ref.shapes.shape_reference import ShapeReference
from mitsuba_ref.shapes.triangle_error import MODEL


def triangle_mesh_reference(
    describes: type[Shape], placed: ExpectedPacking = expected_mesh
) -> ShapeReference:
    """A shape of triangles that goes to Mitsuba as a PLY file."""
    return ShapeReference(describes, mesh_to_xml, {Triangles: MODEL}, placed)


def mesh_to_xml(out: ShapeWriter, shape: Any, part: Any) -> list[XmlElement]:
    return [out.mesh(shape, part)]


# Triangle: a mesh of one face.


TRIANGLE = triangle_mesh_reference(Triangle, expected_triangle)


# Mesh: a PLY file with corners, normals and uv in world space.


MESH = triangle_mesh_reference(MeshFile)


# Rectangle: its triangles.


RECTANGLE = triangle_mesh_reference(Rectangle, expected_rectangle)


# Cube: its triangles.


CUBE = triangle_mesh_reference(Cube, expected_cube)


# Icosphere: its triangles.


ICOSPHERE = triangle_mesh_reference(Icosphere)


# Torus: its triangles.


TORUS = triangle_mesh_reference(Torus)


# Heightfield: its triangles.


HEIGHTFIELD = triangle_mesh_reference(Heightfield)


# Teapot: its triangles.


TEAPOT = triangle_mesh_reference(Teapot)

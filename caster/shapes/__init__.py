"""The registry of shapes: what a scene file may say in `type`."""

from caster.shapes.cube import Cube
from caster.shapes.cylinder import Cylinder
from caster.shapes.disk import Disk
from caster.shapes.heightfield import Heightfield
from caster.shapes.icosphere import Icosphere
from caster.shapes.mesh import MeshFile
from caster.shapes.plane import Plane
from caster.shapes.rectangle import Rectangle
from caster.shapes.sphere import Sphere
from caster.shapes.teapot import Teapot
from caster.shapes.torus import Torus
from caster.shapes.triangle import Triangle

__all__ = [
    "SHAPES",
    "Cube",
    "Cylinder",
    "Disk",
    "Heightfield",
    "Icosphere",
    "MeshFile",
    "Plane",
    "Rectangle",
    "Sphere",
    "Teapot",
    "Torus",
    "Triangle",
]

SHAPES = (
    Sphere,
    Plane,
    Triangle,
    MeshFile,
    Rectangle,
    Disk,
    Cube,
    Cylinder,
    Icosphere,
    Torus,
    Heightfield,
    Teapot,
)

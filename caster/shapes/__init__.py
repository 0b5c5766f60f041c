"""The registry of shapes: what a scene file may say in `type`."""

from caster.shapes.cube import Cube as Cube
from caster.shapes.cylinder import Cylinder as Cylinder
from caster.shapes.disk import Disk as Disk
from caster.shapes.heightfield import Heightfield as Heightfield
from caster.shapes.icosphere import Icosphere as Icosphere
from caster.shapes.mesh import MeshFile as MeshFile
from caster.shapes.plane import Plane as Plane
from caster.shapes.rectangle import Rectangle as Rectangle
from caster.shapes.sphere import Sphere as Sphere
from caster.shapes.teapot import Teapot as Teapot
from caster.shapes.torus import Torus as Torus
from caster.shapes.triangle import Triangle as Triangle

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

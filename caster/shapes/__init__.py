"""Registry of shapes, by the `type` of `[[shape]]` in scene files. `SHAPES.register` adds one from elsewhere."""

from caster.description.fields import Shape
from caster.description.registry import Registry
from caster.shapes.cube import Cube, Rectangle
from caster.shapes.cylinder import Cylinder
from caster.shapes.disk import Disk
from caster.shapes.heightfield import Heightfield
from caster.shapes.icosphere import Icosphere
from caster.shapes.linear_curve import LinearCurve
from caster.shapes.mesh import Mesh
from caster.shapes.plane import Plane
from caster.shapes.sphere import EllipsoidCloud, Sphere, SphereCloud
from caster.shapes.teapot import Teapot
from caster.shapes.torus import Torus
from caster.shapes.triangle import Triangle

__all__ = [
    "SHAPES",
    "Cube",
    "Cylinder",
    "Disk",
    "EllipsoidCloud",
    "Heightfield",
    "Icosphere",
    "LinearCurve",
    "Mesh",
    "Plane",
    "Rectangle",
    "Sphere",
    "SphereCloud",
    "Teapot",
    "Torus",
    "Triangle",
]

SHAPES: Registry[Shape] = Registry(
    Sphere,
    Plane,
    Triangle,
    Mesh,
    Rectangle,
    Disk,
    Cube,
    Cylinder,
    Icosphere,
    Torus,
    Heightfield,
    Teapot,
    SphereCloud,
    EllipsoidCloud,
    LinearCurve,
)

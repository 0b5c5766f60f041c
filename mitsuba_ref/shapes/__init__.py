"""The registry of references: one for every shape of caster.shapes.SHAPES (a test demands it)."""

from mitsuba_ref.shapes import (
    cube,
    cylinder,
    disk,
    heightfield,
    icosphere,
    mesh,
    plane,
    rectangle,
    sphere,
    teapot,
    torus,
    triangle,
)

REFERENCES = (
    sphere.REFERENCE,
    plane.REFERENCE,
    triangle.REFERENCE,
    mesh.REFERENCE,
    rectangle.REFERENCE,
    disk.REFERENCE,
    cube.REFERENCE,
    cylinder.REFERENCE,
    icosphere.REFERENCE,
    torus.REFERENCE,
    heightfield.REFERENCE,
    teapot.REFERENCE,
)

"""The registry of references: one for every shape of caster.shapes.SHAPES (a test demands it)."""

from mitsuba_ref.shapes import cylinder, disk, plane, sphere, triangle_meshes

REFERENCES = (
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
)

"""Triangle: a mesh of one face."""

from caster.shapes.triangle import Triangle
from mitsuba_ref.placed import triangle
from mitsuba_ref.shapes.baked import baked

REFERENCE = baked(Triangle, triangle)

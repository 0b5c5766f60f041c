"""Rectangle: its triangles."""

from caster.shapes.rectangle import Rectangle
from mitsuba_ref.placed import square
from mitsuba_ref.shapes.baked import baked

REFERENCE = baked(Rectangle, square)

"""Cube: its triangles."""

from caster.shapes.cube import Cube
from mitsuba_ref.placed import box
from mitsuba_ref.shapes.baked import baked

REFERENCE = baked(Cube, box)

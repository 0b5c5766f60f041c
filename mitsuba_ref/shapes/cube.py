"""Cube: its triangles."""

from caster.shapes.cube import Cube
from mitsuba_ref.shapes.baked import baked

REFERENCE = baked(Cube)

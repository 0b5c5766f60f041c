"""Cube: Mitsuba's cube."""

from caster.shapes.cube import Cube
from mitsuba_ref.shapes.baked import native

REFERENCE = native(Cube, "cube")

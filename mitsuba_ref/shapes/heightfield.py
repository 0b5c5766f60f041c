"""Heightfield: its triangles."""

from caster.shapes.heightfield import Heightfield
from mitsuba_ref.shapes.baked import baked

REFERENCE = baked(Heightfield)

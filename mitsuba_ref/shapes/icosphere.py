"""Icosphere: its triangles."""

from caster.shapes.icosphere import Icosphere
from mitsuba_ref.shapes.baked import baked

REFERENCE = baked(Icosphere)

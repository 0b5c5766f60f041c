"""Torus: its triangles."""

from caster.shapes.torus import Torus
from mitsuba_ref.shapes.baked import baked

REFERENCE = baked(Torus)

"""Teapot: its triangles."""

from caster.shapes.teapot import Teapot
from mitsuba_ref.shapes.baked import baked

REFERENCE = baked(Teapot)

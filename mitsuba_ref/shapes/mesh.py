"""Mesh: a PLY file with corners, normals and uv in world space."""

from caster.shapes.mesh import MeshFile
from mitsuba_ref.shapes.baked import baked

REFERENCE = baked(MeshFile)

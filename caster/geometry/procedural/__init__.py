"""Meshes that are computed: the same numbers give the same triangles, and no file is needed.

All are in object space, faces counter-clockwise seen from outside. Bad parameters raise SceneError.
"""

from caster.geometry.procedural.heightfield import heightfield
from caster.geometry.procedural.icosphere import icosphere
from caster.geometry.procedural.teapot import teapot
from caster.geometry.procedural.torus import torus

__all__ = ["heightfield", "icosphere", "teapot", "torus"]

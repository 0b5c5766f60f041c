"""Meshes that are computed: the same numbers give the same triangles, and no file is needed.

All are in object space, faces counter-clockwise seen from outside. Bad parameters raise SceneError.
"""

from caster.procedural.heightfield import heightfield
from caster.procedural.icosphere import icosphere
from caster.procedural.teapot import teapot
from caster.procedural.torus import torus

__all__ = ["heightfield", "icosphere", "teapot", "torus"]

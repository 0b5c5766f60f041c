"""The plan of a render: which steps the scene and the requested AOVs need."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from caster.aovs import needs_of
from caster.jit.decorators import implements
from caster.kernels.protocol import project
from caster.kernels.raster.tile import NORMALS, SURFACES, SURFACES_WITH_UV
from caster.rendering.casting import Culling
from caster.scene.model import Scene

__all__ = ["culling_for"]


@dataclass(frozen=True)
class Plan:
    """How a film is rendered."""

    culling: Culling
    needs: frozenset[str]  # fields of a hit that some AOV needs
    surfaces: int | None  # what is computed of each hit's surface: NORMALS, SURFACES or SURFACES_WITH_UV; None: nothing
    shadows: bool  # whether shadow rays are cast


def plan(scene: Scene, aovs: Sequence[str], culling: Culling | None = None) -> Plan:
    """Plan the render of some AOVs. culling: the requested one."""
    chosen = culling or culling_for(scene.camera.pack(scene.film.width, scene.film.height))
    needs = needs_of(aovs)
    lit = "radiance" in needs and any(light.type != "ambient" for light in scene.lights)
    textured = any(scene.textures) and needs & {"albedo", "radiance"}
    surfaces = None
    if textured or "uv" in needs:
        surfaces = SURFACES_WITH_UV
    elif lit or needs & {"position", "shading_normal"}:
        surfaces = SURFACES
    elif "normal" in needs:
        surfaces = NORMALS
    return Plan(chosen, needs, surfaces, lit and scene.shading.shadows)


def culling_for(camera: Any) -> Culling:
    """The culling for a packed camera's own rays; those of one that projects no points traverse the BVHs."""
    return "raster" if implements(project, type(camera)) else "bvh"

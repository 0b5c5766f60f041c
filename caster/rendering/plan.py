"""The plan of a render: which steps the scene and the requested AOVs need, and why."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from caster.aovs import AOVS, BY_NAME
from caster.jit.decorators import implements
from caster.kernels.protocol import distortion_bound, project, project_bounding_sphere
from caster.rendering.casting import Culling
from caster.scene.model import Scene

__all__ = ["culling_for"]

# Fields of a hit that are computed together; the geometric normal can be computed alone.
SURFACE_FIELDS = frozenset({"position", "shading_normal", "uv"})


class Step(NamedTuple):
    """Whether a step runs, and why."""

    runs: bool
    reason: str


@dataclass(frozen=True)
class Plan:
    """How a film is rendered."""

    culling: Culling
    reason: str  # for the culling
    needs: frozenset[str]  # fields of a hit that some AOV needs
    surfaces: tuple[str, ...]  # computed fields of each hit's surface: some of position, normals, uv
    surfaces_reason: str
    shading: Step  # by lights other than ambient ones
    shadows: Step
    trees: Step


def plan(scene: Scene, aovs: Sequence[str], culling: Culling | None = None) -> Plan:
    """Plan the render of some AOVs. culling: the requested one."""
    chosen, reason = culling_for(scene.camera.pack(scene.film.width, scene.film.height))
    if culling is not None:
        chosen, reason = culling, "as requested"
    shading = shadows = _shading(scene, aovs)
    if shading.runs and scene.shading.shadows:
        shadows = Step(True, "from each hit to the lights it faces, until anything is in the way")
    elif shading.runs:
        shadows = Step(False, "the scene switches shadows off")
    trees = Step(shadows.runs, "shadow rays traverse them" if shadows.runs else "no ray needs one")
    if chosen == "bvh":
        trees = Step(True, "camera rays traverse them")
    needs = frozenset(field for name in aovs for field in BY_NAME[name].NEEDS)
    return Plan(chosen, reason, needs, *_surfaces(scene, aovs, shading), shading, shadows, trees)


def culling_for(camera: Any) -> tuple[Culling, str]:
    """(culling, reason) for a packed camera's own rays."""
    kind = type(camera)
    if implements(project, kind) and not implements(distortion_bound, kind):
        return "raster", "the camera is rectilinear, so each primitive stays within the bounds of its projected points"
    if implements(project, kind) and implements(project_bounding_sphere, kind):
        return "raster", "each primitive stays within bounds of its projected points or of its bounding sphere"
    return "bvh", "the camera cannot project primitives, so rays traverse the BVHs"


def _shading(scene: Scene, aovs: Sequence[str]) -> Step:
    lights = sum(light.type != "ambient" for light in scene.lights)
    lit = [name for name in aovs if "radiance" in BY_NAME[name].NEEDS]
    if not lit:
        every = [aov.NAME for aov in AOVS if "radiance" in aov.NEEDS]
        return Step(False, f"{' or '.join(every)} was not requested")
    if not lights:
        return Step(False, "no light of the scene comes from anywhere")
    return Step(True, f"{' and '.join(lit)} was requested, and {lights} lights come from somewhere")


def _surfaces(scene: Scene, aovs: Sequence[str], shading: Step) -> tuple[tuple[str, ...], str]:
    """(computed fields, reason)."""
    needs = {aov.NAME: set(aov.NEEDS) for aov in AOVS if aov.NAME in aovs}
    if any(scene.textures):
        needs = {name: fields | {"uv"} if fields & {"albedo", "radiance"} else fields for name, fields in needs.items()}
    lit = {"radiance"} if shading.runs else set()
    wanting = [name for name, fields in needs.items() if fields & (SURFACE_FIELDS | lit) or fields > {"normal"}]
    if wanting:
        uv = any("uv" in fields for fields in needs.values())
        return ("position", "normals", "uv") if uv else ("position", "normals"), f"for {', '.join(wanting)}"
    if normal := [name for name, fields in needs.items() if "normal" in fields]:
        return ("normals",), f"for {', '.join(normal)}"
    return (), "no requested AOV needs them"

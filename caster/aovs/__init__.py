"""The registry of AOVs. Each says its NAME, EXR CHANNELS and value on a MISS, and how to `evaluate` it."""

from types import ModuleType

from caster.aovs import albedo, depth, diffuse, hit, normal, position, prim_id, shading_normal, shape_id, uv

__all__ = ["AOVS", "BY_NAME"]

AOVS: tuple[ModuleType, ...] = (
    hit,
    depth,
    normal,
    shading_normal,
    position,
    uv,
    albedo,
    diffuse,
    shape_id,
    prim_id,
)

BY_NAME = {aov.NAME: aov for aov in AOVS}

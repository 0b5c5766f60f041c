"""The registry of checks that compare pixel by pixel. Each has a NAME and a `ratio`: error over bound, (n,)."""

from types import ModuleType

from mitsuba_ref.judge.checks import depth, mask, normal, on_surface, position, shading_normal, shape_id

CHECKS: tuple[ModuleType, ...] = (mask, shape_id, on_surface, depth, position, normal, shading_normal)

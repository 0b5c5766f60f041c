"""Numerical stability: sweeps of scenes in which one quantity gets extreme, listed in the order of docs/stress.md."""

from mitsuba_ref.stress import degenerate, magnitudes, surfaces
from mitsuba_ref.stress.family import Family

FAMILIES: tuple[Family, ...] = (
    magnitudes.SCALE_MESH,
    magnitudes.SCALE_SPHERE,
    magnitudes.OFFSET_MESH,
    magnitudes.OFFSET_SPHERE,
    magnitudes.DISTANCE_TRIANGLE,
    magnitudes.DISTANCE_SPHERE,
    degenerate.GRAZING_RECTANGLE,
    degenerate.GRAZING_DISK,
    degenerate.SLIVER,
    degenerate.TANGENCY,
    surfaces.WATERTIGHT_EDGES,
    surfaces.WATERTIGHT_VERTICES,
    magnitudes.LENGTH_MESH,
    magnitudes.LENGTH_SPHERE,
    degenerate.AXIS,
    degenerate.CONDITION,
    magnitudes.FIELD_OF_VIEW,
    magnitudes.FILM_SIZE,
    surfaces.COINCIDENT_TRIANGLES,
    surfaces.COINCIDENT_SPHERES,
    surfaces.SHADOW_SPHERE,
    surfaces.SHADOW_MESH,
)

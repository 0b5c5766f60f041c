"""The registry of sweeps, in the order of the report. `mitsuba-ref stress` runs them; docs/stress.md shows them."""

from mitsuba_ref.stress import (
    axis,
    coincident,
    condition,
    distance,
    film,
    grazing,
    length,
    offset,
    scale,
    shadow,
    sliver,
    tangency,
    watertight,
)
from mitsuba_ref.stress.family import Family

FAMILIES: tuple[Family, ...] = (
    scale.MESH,
    scale.SPHERE,
    offset.MESH,
    offset.SPHERE,
    distance.TRIANGLE,
    distance.SPHERE,
    grazing.RECTANGLE,
    grazing.DISK,
    sliver.FAMILY,
    tangency.FAMILY,
    watertight.EDGES,
    watertight.VERTICES,
    length.MESH,
    length.SPHERE,
    axis.FAMILY,
    condition.FAMILY,
    film.FIELD,
    film.SIDE,
    coincident.TRIANGLES,
    coincident.SPHERES,
    shadow.SPHERE,
    shadow.MESH,
)

"""77 edge cases of ray casting, as tables: what each is, and how its scenes and rays are made."""

from cases import boxes, cameras, cylinders, flat, garbage, meshes, refused, spheres, triangles
from cases.case import Case

ALL = (
    *spheres.CASES,
    *triangles.CASES,
    *meshes.CASES,
    *flat.CASES,
    *cylinders.CASES,
    *boxes.CASES,
    *cameras.CASES,
    *refused.CASES,
    *garbage.CASES,
)
CASES: tuple[Case, ...] = tuple(sorted(ALL, key=lambda case: case.number))

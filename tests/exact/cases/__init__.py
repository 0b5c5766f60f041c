"""77 edge cases of ray casting, as tables: what each is, and how its scenes and rays are made."""

from cases import boxes, cameras, cylinders, flat, invalid_cameras, invalid_meshes, meshes, spheres, triangles
from cases.case import Case

ALL = (
    *spheres.CASES,
    *triangles.CASES,
    *meshes.CASES,
    *flat.CASES,
    *cylinders.CASES,
    *boxes.CASES,
    *cameras.CASES,
    *invalid_cameras.CASES,
    *invalid_meshes.CASES,
)
CASES: tuple[Case, ...] = tuple(sorted(ALL, key=lambda case: case.number))

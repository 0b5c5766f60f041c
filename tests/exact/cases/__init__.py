"""Edge cases of ray casting, as tables: what each is, and how its scenes and rays are made."""

from cases import boxes, cylinders, flat, meshes, spheres, triangles
from cases.case import Case

CASES: tuple[Case, ...] = tuple(
    sorted(
        (*spheres.CASES, *triangles.CASES, *meshes.CASES, *flat.CASES, *cylinders.CASES, *boxes.CASES),
        key=lambda case: case.number,
    )
)

"""Edge cases of ray casting, as tables: what each is, and how its scenes and rays are made."""

from cases import cylinders, flat, spheres, triangles
from cases.case import Case

CASES: tuple[Case, ...] = tuple(
    sorted((*spheres.CASES, *triangles.CASES, *flat.CASES, *cylinders.CASES), key=lambda case: case.number)
)

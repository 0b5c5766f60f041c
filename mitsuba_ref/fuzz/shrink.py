"""Shrinking of a failing case: fewer shapes and fields, simpler numbers, one ray, while it fails in the same way.

Not Hypothesis's shrinker: that one shortens the choices a generator made, so it needs the generator to be its own, and
it cannot leave the numbers that the generator draws. Here the scene itself shrinks, as a scene file has it: meshes
become triangles, steps of a transform one matrix, numbers lose digits.
"""

import copy
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from caster.description.errors import SceneError
from caster.geometry.packing import pack, primitive_count
from caster.rendering.images import camera_rays
from mitsuba_ref.fuzz.cases import Case, case_of, scene_data
from mitsuba_ref.fuzz.findings import Finding
from mitsuba_ref.hard.family import scene_of
from mitsuba_ref.hard.rays import RayBatch
from mitsuba_ref.subjects.subject import describe_surface

Path = tuple[str | int, ...]

SHRINK_ATTEMPTS = 1500  # of one finding: a few seconds, since an attempt casts one ray
DIGITS = (1, 2, 3, 5, 8, 12)  # significant decimal digits of a number, tried in this order
MAX_EXPANDED_FACES = 2000  # faces of a mesh that is rewritten as triangles


@dataclass
class Shrinker:
    """Holds the smallest case that still fails in the mode of the finding, and the finding about it."""

    case: Case
    finding: Finding
    judge: Callable[[Case], list[Finding]]  # may get anything, and raises nothing
    attempts: int = SHRINK_ATTEMPTS
    until: float = math.inf  # time.monotonic() after which no attempt is made

    def accepts(self, case: Case) -> bool:
        """Whether this fails as well; then it replaces the case."""
        if case == self.case or self.attempts <= 0 or time.monotonic() >= self.until:
            return False
        self.attempts -= 1
        again = next((found for found in self.judge(case) if found.mode == self.finding.mode), None)
        if again is None:
            return False
        self.case, self.finding = case, again
        return True

    def run(self) -> None:
        """All passes, repeated until none changes anything or the attempts are used up.

        Shapes are rewritten as primitives once: that adds the fields with a default that the next pass removes.
        """
        if self.finding.ray is not None:
            self.accepts(case_of(self.case, self.finding.ray))
        while self.crop():
            pass
        self.expand()
        while any([self.crop(), self.remove(), self.simplify()]):
            pass

    def crop(self) -> bool:
        """Halve the film's window; cast the ray of a window of one pixel alone."""
        film = self.case["film"]
        if "limits" in self.case or not film:
            return False
        scene = scene_of(scene_data(self.case))
        x0, y0, x1, y1 = scene.film.window
        if (x1 - x0) * (y1 - y0) == 1:
            rays = camera_rays(scene)
            return self.accepts(case_of(self.case, RayBatch(rays.o, rays.d, rays.t_min, rays.t_max)))
        x, y = (x0 + x1) // 2, (y0 + y1) // 2
        halves = ([x0, y0, x, y1], [x, y0, x1, y1]) if x > x0 else ([x0, y0, x1, y], [x0, y, x1, y1])
        return any(self.accepts({**self.case, "film": {**film, "crop": half}}) for half in halves)

    def expand(self) -> None:
        """Rewrite shapes as the primitives they pack to: triangles for a mesh, one matrix for a transform."""
        for i in range(len(self.case["shape"]) - 1, -1, -1):
            shapes = self.case["shape"]
            plain = primitive_shapes(self.case, i)
            if plain and plain != [shapes[i]]:
                self.accepts({**self.case, "shape": [*shapes[:i], *plain, *shapes[i + 1 :]]})

    def remove(self) -> bool:
        """Remove shapes, fields with a default, and steps of transforms."""
        changed = False
        for path, value in reversed(list(walk(self.case))):
            is_part = isinstance(path[-1], str) or isinstance(value, dict)
            if is_part and len(path) > 1 and path[0] not in ("film", "limits") and path[-1] != "type":
                changed |= self.accepts_at(path)
        return changed

    def simplify(self) -> bool:
        """Replace each number by the simplest one that still fails."""
        changed = False
        for path, value in list(walk(self.case)):
            if isinstance(value, float) and path[0] != "film":
                changed |= any(self.accepts_at(path, number) for number in simpler_numbers(value))
        return changed

    def accepts_at(self, path: Path, number: float | None = None) -> bool:
        """Whether the case fails as well without what is at a path, or with a number there; False where it is gone."""
        case = copy.deepcopy(self.case)
        holder: Any = case
        try:
            for key in path[:-1]:
                holder = holder[key]
            if number is None:
                del holder[path[-1]]
            else:
                holder[path[-1]] = number
        except (LookupError, TypeError):
            return False
        return self.accepts(case)


def walk(value: Any, path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """All values with their paths, containers before their contents."""
    if path:
        yield path, value
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield from walk(item, (*path, key))


def complexity(x: float) -> tuple[int, int]:
    """How complicated a number is: the length of its digits; 0 is the simplest."""
    return (int(x != 0.0), len(repr(x)))


def simpler_numbers(x: float) -> Iterator[float]:
    """Numbers that might do instead of x, the simplest first, each simpler than x; none for an infinite one."""
    if math.isfinite(x):
        candidates = (0.0, 1.0, *(float(f"{x:.{digits}g}") for digits in DIGITS), abs(x))
        yield from (y for y in dict.fromkeys(candidates) if math.isfinite(y) and complexity(y) < complexity(x))


def primitive_shapes(case: Case, i: int) -> list[dict[str, Any]]:
    """Shapes that pack to the same primitives in the same order, one each; none for an unknown kind."""
    alone = scene_data({**case, "shape": [case["shape"][i]]})
    try:
        part = pack(scene_of(alone)).parts[0]
        if primitive_count(part) > MAX_EXPANDED_FACES:
            return []
        with np.errstate(all="ignore"):
            return [describe_surface(part, k) for k in range(primitive_count(part))]
    except (SceneError, LookupError):
        return []

"""Shrinking of a failing case, while it fails in the same way: one ray, or a small film; few shapes, single triangles.

Not Hypothesis's shrinker: that one shortens the choices a generator made, so it needs the generator to be its own. Here
the scene itself shrinks, as a scene file has it.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from caster.description.errors import SceneError
from caster.geometry.packing import pack, primitive_count
from caster.rendering.images import camera_rays
from mitsuba_ref.error_model.intersections import Rays
from mitsuba_ref.fuzz.cases import Case, case_of, scene_data
from mitsuba_ref.fuzz.findings import Finding
from mitsuba_ref.hard.family import scene_of
from mitsuba_ref.subjects.subject import describe_surface

SHRINK_ATTEMPTS = 1500  # of one finding: a few seconds, since an attempt casts one ray
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
        """Cut the film, leave out shapes, and rewrite those that are left as primitives, of which most go as well."""
        if self.finding.ray is not None:
            self.accepts(case_of(self.case, self.finding.ray))
        while self.crop():
            pass
        self.remove_shapes()
        for i in range(len(self.case["shape"]) - 1, -1, -1):
            shapes = self.case["shape"]
            self.accepts({**self.case, "shape": [*shapes[:i], *primitive_shapes(self.case, i), *shapes[i + 1 :]]})
        self.remove_shapes()
        for name in [key for key in self.case if key not in ("film", "camera", "shape", "limits")]:
            self.accepts({key: value for key, value in self.case.items() if key != name})

    def crop(self) -> bool:
        """Halve the film's window; cast the ray of a window of one pixel alone."""
        film = self.case["film"]
        if "limits" in self.case or not film:
            return False
        scene = scene_of(scene_data(self.case))
        x0, y0, x1, y1 = scene.film.window
        if (x1 - x0) * (y1 - y0) == 1:
            return self.accepts(case_of(self.case, Rays(*camera_rays(scene))))
        x, y = (x0 + x1) // 2, (y0 + y1) // 2
        halves = ([x0, y0, x, y1], [x, y0, x1, y1]) if x > x0 else ([x0, y0, x1, y], [x0, y, x1, y1])
        return any(self.accepts({**self.case, "film": {**film, "crop": half}}) for half in halves)

    def remove_shapes(self) -> None:
        """Leave out shapes: all, each half, each quarter and so on, down to each alone."""
        size = len(self.case["shape"])
        while size:
            for start in reversed(range(0, len(self.case["shape"]), size)):
                shapes = self.case["shape"]
                self.accepts({**self.case, "shape": shapes[:start] + shapes[start + size :]})
            size //= 2


def primitive_shapes(case: Case, i: int) -> list[dict[str, Any]]:
    """Shapes that pack to the primitives of shape i in the same order, one each; the shape itself if that fails."""
    shape = case["shape"][i]
    try:
        part = pack(scene_of(scene_data({**case, "shape": [shape]}))).parts[0]
        count = primitive_count(part)
        with np.errstate(all="ignore"):
            return [describe_surface(part, k) for k in range(count)] if count <= MAX_EXPANDED_FACES else [shape]
    except (SceneError, LookupError):
        return [shape]

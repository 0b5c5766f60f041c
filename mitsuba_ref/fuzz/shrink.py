"""Shrinking of a failing case: fewer shapes and fields, simpler numbers, one ray, while it fails in the same way.

Not Hypothesis's shrinker: that one shortens the choices a generator made, so it needs the generator to be its own, and
it cannot leave the numbers that the generator draws. Here the scene itself shrinks, as a scene file has it: meshes
become triangles, steps of a transform one matrix, numbers lose bits.
"""

import copy
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from caster.description.errors import SceneError
from caster.geometry.packing import pack, primitive_count
from caster.rendering.images import camera_rays
from mitsuba_ref.fuzz.cases import Case, case_of, findings_of, scene_data
from mitsuba_ref.fuzz.findings import Finding
from mitsuba_ref.hard.family import scene_of
from mitsuba_ref.hard.rays import RayBatch
from mitsuba_ref.subjects.subject import describe_surface

DataPath = tuple[str | int, ...]
Judge = Callable[[Case], list[Finding]]

SHRINK_ATTEMPTS = 1500  # of one finding: a few seconds, since an attempt casts one ray
MANTISSA_BITS = (1, 2, 3, 4, 6, 8, 12, 24)  # of a mantissa, tried in this order
MAX_EXPANDED_FACES = 2000  # faces of a mesh that is rewritten as triangles


def complexity(x: float) -> tuple[int, float]:
    """How complicated a number is: the bits of its mantissa, then how far it is from 1."""
    if x == 0.0:
        return (0, math.copysign(0.5, -x) + 0.5)  # 0.0 before -0.0
    mantissa, exponent = math.frexp(abs(x))
    bits = int(mantissa * 2.0**53)
    significant = 53 - (bits & -bits).bit_length() + 1
    return (significant, abs(exponent - 1) + (0.5 if x < 0.0 else 0.0))


def simpler_numbers(x: float) -> Iterator[float]:
    """Numbers that might do instead of x, the simplest first, each simpler than x; none for an infinite one."""
    if not math.isfinite(x):
        return
    mantissa, exponent = math.frexp(x)
    rounded = [math.ldexp(round(math.ldexp(mantissa, n)), exponent - n) for n in MANTISSA_BITS if exponent - n < 1000]
    candidates = [0.0, 1.0, -1.0, abs(x), *rounded, math.ldexp(mantissa, 1)]
    tried: list[float] = []
    for candidate in candidates:
        if math.isfinite(candidate) and candidate not in tried and complexity(candidate) < complexity(x):
            tried.append(candidate)
            yield candidate


@dataclass
class Budget:
    """How often the shrinker may still try, and until when."""

    attempts: int = SHRINK_ATTEMPTS
    until: float = math.inf  # time.monotonic()

    def spend(self) -> bool:
        """Whether there is one more attempt; that one is then gone."""
        self.attempts -= 1
        return self.attempts >= 0 and time.monotonic() < self.until


class Shrinker:
    """Holds the smallest that still fails."""

    def __init__(self, data: Case, fails: Callable[[Case], bool], budget: Budget) -> None:
        """fails: whether this data still fails in the same way; it may get anything, and raises nothing."""
        self.data, self.fails, self.budget = data, fails, budget

    def accepts(self, data: Case) -> bool:
        """Whether this fails as well; then it is what goes on."""
        if data == self.data or not self.budget.spend() or not self.fails(data):
            return False
        self.data = data
        return True

    def run(self, passes: Sequence[Callable[["Shrinker"], bool]]) -> Case:
        """All passes, repeated until none changes anything or the attempts are used up."""
        while any([each(self) for each in passes]):
            pass
        return self.data


def fewer_shapes(shrinker: Shrinker) -> bool:
    """Remove runs of shapes, long ones first."""
    changed = False
    size = len(shrinker.data["shape"])
    while size >= 1:
        start = 0
        while start < len(shrinker.data["shape"]):
            shapes = shrinker.data["shape"]
            left = shapes[:start] + shapes[start + size :]
            if left and shrinker.accepts({**shrinker.data, "shape": left}):
                changed = True
            else:
                start += size
        size //= 2
    return changed


def fewer_fields(shrinker: Shrinker) -> bool:
    """Remove fields with a default, and steps of transforms."""
    changed = False
    for path, value in list(walk(shrinker.data)):
        is_field = isinstance(path[-1], str) or isinstance(value, dict)
        if is_field and len(path) > 1 and path[0] not in ("film", "ray") and path[-1] != "type":
            changed |= accepts_at(shrinker, path)
    return changed


def rounder_numbers(shrinker: Shrinker) -> bool:
    """Replace each number by the simplest one that still fails."""
    changed = False
    for path, value in list(walk(shrinker.data)):
        if isinstance(value, float) and path[0] != "film":
            changed |= any(accepts_at(shrinker, path, number) for number in simpler_numbers(value))
    return changed


def walk(value: Any, path: DataPath = ()) -> Iterator[tuple[DataPath, Any]]:
    """All values with their paths, containers before their contents."""
    if path:
        yield path, value
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield from walk(item, (*path, key))


def accepts_at(shrinker: Shrinker, path: DataPath, number: float | None = None) -> bool:
    """Whether the data fails as well without what is at a path, or with a number there; False where it is gone."""
    data = copy.deepcopy(shrinker.data)
    holder: Any = data
    try:
        for key in path[:-1]:
            holder = holder[key]
        if number is None:
            del holder[path[-1]]
        else:
            holder[path[-1]] = number
    except (LookupError, TypeError):
        return False
    return shrinker.accepts(data)


def smallest_case(case: Case, finding: Finding, judge: Judge = findings_of, budget: Budget | None = None) -> Case:
    """The smallest case of the same failure mode; of a single ray instead of a pixel, if that fails as well."""

    def fails(data: Case) -> bool:
        return finding.mode in failure_modes(data, judge)

    shrinker = Shrinker(single_ray_case(case, finding, judge), fails, budget or Budget())
    return shrinker.run([as_primitives, fewer_shapes, fewer_fields, translated_to_origin, rounder_numbers])


def failure_modes(case: Case, judge: Judge) -> set[tuple[str, str]]:
    return {finding.mode for finding in judge(case)}


def single_ray_case(case: Case, finding: Finding, judge: Judge) -> Case:
    """The case with the finding's one ray, or with one pixel, if that is enough."""
    candidates = [] if finding.ray is None else [case_of(case, finding.ray)]
    if finding.pixel is not None and "ray" not in case:
        x, y = finding.pixel
        cropped = {**case, "film": {**case["film"], "crop": [x, y, x + 1, y + 1]}}
        rays = camera_rays(scene_of(scene_data(cropped)))
        if finding.ray is None:
            candidates.append(case_of(cropped, RayBatch(rays.o, rays.d, rays.t_min, rays.t_max)))
        candidates.append(cropped)
    return next((each for each in candidates if finding.mode in failure_modes(each, judge)), case)


def as_primitives(shrinker: Shrinker) -> bool:
    """Rewrite shapes as what they pack to: triangles for a mesh, one matrix for a transform."""
    changed = False
    for i in range(len(shrinker.data["shape"]) - 1, -1, -1):
        shapes = shrinker.data["shape"]
        plain = primitive_shapes(shrinker.data, i)
        if plain and plain != [shapes[i]]:
            changed |= shrinker.accepts({**shrinker.data, "shape": [*shapes[:i], *plain, *shapes[i + 1 :]]})
    return changed


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


def translated_to_origin(shrinker: Shrinker) -> bool:
    """Translate everything so that the ray starts at the origin."""
    ray = shrinker.data.get("ray")
    if ray is None or not any(ray["o"]):
        return False
    shapes = [translated(shape, -np.array(ray["o"])) for shape in shrinker.data["shape"]]
    if None in shapes:
        return False
    return shrinker.accepts({**shrinker.data, "shape": shapes, "ray": {**ray, "o": [0.0, 0.0, 0.0]}})


def translated(shape: dict[str, Any], by: np.ndarray) -> dict[str, Any] | None:
    """A shape as written by `primitive_shapes`, translated; None for any other."""
    steps = shape.get("to_world", [])
    if not steps:
        for key in ("vertices", "center", "point"):
            if key in shape:
                return {**shape, key: (np.array(shape[key]) + by).tolist()}
    if len(steps) == 1 and "matrix" in steps[0]:
        matrix = np.array(steps[0]["matrix"])
        matrix[:3, 3] += by
        return {**shape, "to_world": [{"matrix": matrix.tolist()}]}
    return None

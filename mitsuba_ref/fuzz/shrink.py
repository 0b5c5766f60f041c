"""Shrinking of a failing case: fewer shapes and fields, simpler numbers, one ray, while it fails in the same way."""

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
from mitsuba_ref.fuzz.cases import Case, findings_of
from mitsuba_ref.fuzz.findings import Finding
from mitsuba_ref.judge.checks.adversarial_rays import RayBatch
from mitsuba_ref.subjects.subject import describe_surface

MANTISSA_BITS = (1, 2, 3, 4, 6, 8, 12, 24)  # of a mantissa, tried in this order


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
    tried = {x}
    for candidate in _simpler_candidates(x):
        if math.isfinite(candidate) and candidate not in tried and complexity(candidate) < complexity(x):
            tried.add(candidate)
            yield candidate
    if x == 0.0 and math.copysign(1.0, x) < 0.0:
        yield 0.0


def _simpler_candidates(x: float) -> Iterator[float]:
    yield from (0.0, 1.0, -1.0)
    if x == 0.0:
        return
    yield abs(x)
    mantissa, exponent = math.frexp(x)
    for bits in MANTISSA_BITS:
        rounded = round(math.ldexp(mantissa, bits))
        if exponent - bits < 1000:
            yield math.ldexp(rounded, exponent - bits)
    yield math.ldexp(mantissa, 1)


# A failing scene made small: fewer shapes, rounder numbers, as long as it fails in the same way.
#
# Not hypothesis's shrinker: that one shortens the choices a generator made, so it needs the generator to be
# its own, and
# it cannot leave the numbers that the generator draws. Here the scene itself shrinks, as a scene file has it: meshes
# become triangles, steps of a transform one matrix, numbers lose bits.


Data = dict[str, Any]
DataPath = tuple[str | int, ...]

SHRINK_ATTEMPTS = 1500  # of one finding: a few seconds, since an attempt casts one ray


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

    def __init__(self, data: Data, fails: Callable[[Data], bool], budget: Budget) -> None:
        """fails: whether this data still fails in the same way; it may get anything, and raises nothing."""
        self.data, self.fails, self.budget = data, fails, budget

    def accepts(self, data: Data) -> bool:
        """Whether this fails as well; then it is what goes on."""
        if data == self.data or not self.budget.spend() or not self.fails(data):
            return False
        self.data = data
        return True

    def run(self, passes: Sequence[Callable[["Shrinker"], bool]]) -> Data:
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
            changed |= exists(shrinker.data, path) and shrinker.accepts(without(shrinker.data, path))
    return changed


def rounder_numbers(shrinker: Shrinker) -> bool:
    """Replace each number by the simplest one that still fails."""
    changed = False
    for path, value in list(walk(shrinker.data)):
        if isinstance(value, float) and path[0] != "film":
            changed |= any(
                shrinker.accepts(with_value(shrinker.data, path, number)) for number in simpler_numbers(value)
            )
    return changed


def walk(value: Any, path: DataPath = ()) -> Iterator[tuple[DataPath, Any]]:
    """All values with their paths, containers before their contents."""
    if path:
        yield path, value
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield from walk(item, (*path, key))


def exists(data: Any, path: DataPath) -> bool:
    for key in path:
        if isinstance(data, dict):
            if key not in data:
                return False
        elif not isinstance(data, list) or not isinstance(key, int) or key >= len(data):
            return False
        data = data[key]
    return True


def with_value(data: Data, path: DataPath, value: Any) -> Data:
    """A copy with another value at the path."""
    out = copy.deepcopy(data)
    _holder(out, path)[path[-1]] = value
    return out


def without(data: Data, path: DataPath) -> Data:
    """A copy without the value at the path."""
    out = copy.deepcopy(data)
    del _holder(out, path)[path[-1]]
    return out


def _holder(data: Any, path: DataPath) -> Any:
    for key in path[:-1]:
        data = data[key]
    return data


ShapeFields = dict[str, Any]


def as_packed(part: Any) -> list[ShapeFields]:
    """Shapes that pack to the same primitives in the same order, one each. Raises LookupError for an unknown kind."""
    with np.errstate(all="ignore"):
        return [describe_surface(part, k) for k in range(primitive_count(part))]


def translated(shape: ShapeFields, by: np.ndarray) -> ShapeFields | None:
    """A shape as written by `as_packed`, translated; None for any other."""
    if "vertices" in shape and "to_world" not in shape:
        return {**shape, "vertices": (np.array(shape["vertices"]) + by).tolist()}
    for key in ("center", "point"):
        if key in shape and "to_world" not in shape:
            return {**shape, key: (np.array(shape[key]) + by).tolist()}
    steps = shape.get("to_world", [])
    if len(steps) == 1 and "matrix" in steps[0]:
        matrix = np.array(steps[0]["matrix"])
        matrix[:3, 3] += by
        return {**shape, "to_world": [{"matrix": matrix.tolist()}]}
    return None


Judge = Callable[[Case], list[Finding]]
MAX_EXPANDED_FACES = 2000  # faces of a mesh that is rewritten as triangles


def smallest_case(case: Case, finding: Finding, judge: Judge = findings_of, budget: Budget | None = None) -> Case:
    """The smallest case of the same failure mode; of a single ray instead of a pixel, if that fails as well."""

    def fails(data: Data) -> bool:
        return finding.mode in failure_modes(Case.of(data), judge)

    start = single_ray_case(case, finding, judge)
    shrinker = Shrinker(start.to_data(), fails, budget or Budget())
    passes = [as_primitives, fewer_shapes, fewer_fields, translated_to_origin, rounder_numbers]
    return Case.of(shrinker.run(passes))


def failure_modes(case: Case, judge: Judge) -> set[tuple[str, str]]:
    return {finding.mode for finding in judge(case)}


def single_ray_case(case: Case, finding: Finding, judge: Judge) -> Case:
    """The case with the finding's one ray, or with one pixel, if that is enough."""
    rays = [] if finding.ray is None else [finding.ray]
    pixel = finding.pixel
    if pixel is not None:
        x, y = pixel
        x0, y0, x1, y1 = case.scene().film.window
        if not (x0 <= x < x1 and y0 <= y < y1):  # of a route, whose film may be another one
            pixel = None
    if pixel is not None:
        cropped = case._replace(film={**case.film, "crop": [x, y, x + 1, y + 1]})
        rays += [] if finding.ray is not None else ray_of(cropped)
    for ray in rays:
        alone = case._replace(ray=ray)
        if finding.mode in failure_modes(alone, judge):
            return alone
    if pixel is not None and finding.mode in failure_modes(cropped, judge):
        return cropped
    return case


def ray_of(cropped: Case) -> list[RayBatch]:
    rays = camera_rays(cropped.scene())
    return [RayBatch(rays.o, rays.d, rays.t_min, rays.t_max)]


def as_primitives(shrinker: Shrinker) -> bool:
    """Rewrite shapes as what they pack to: triangles for a mesh, one matrix for a transform."""
    changed = False
    for i in range(len(shrinker.data["shape"]) - 1, -1, -1):
        shapes = shrinker.data["shape"]
        plain = _primitive_shapes(shrinker.data, i)
        if plain and plain != [shapes[i]]:
            changed |= shrinker.accepts({**shrinker.data, "shape": [*shapes[:i], *plain, *shapes[i + 1 :]]})
    return changed


def _primitive_shapes(data: Data, i: int) -> list[dict[str, Any]]:
    alone = Case.of({**data, "shape": [data["shape"][i]]})
    try:
        part = pack(alone.scene()).parts[0]
        return as_packed(part) if primitive_count(part) <= MAX_EXPANDED_FACES else []
    except (SceneError, LookupError):
        return []


def translated_to_origin(shrinker: Shrinker) -> bool:
    """Translate everything so that the ray starts at the origin."""
    ray = shrinker.data.get("ray")
    if ray is None or not any(ray["o"]):
        return False
    by = -np.array(ray["o"])
    shapes = [translated(shape, by) for shape in shrinker.data["shape"]]
    if None in shapes:
        return False
    return shrinker.accepts({**shrinker.data, "shape": shapes, "ray": {**ray, "o": [0.0, 0.0, 0.0]}})

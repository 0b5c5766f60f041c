"""A failing scene made small: fewer shapes, rounder numbers, as long as it fails in the same way.

Not hypothesis's shrinker: that one shortens the choices a generator made, so it needs the generator to be its own, and
it cannot leave the numbers that the generator draws. Here the scene itself shrinks, as a scene file has it: meshes
become triangles, steps of a transform one matrix, numbers lose bits.
"""

import copy
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from mitsuba_ref.fuzz.simpler import simpler

Data = dict[str, Any]
Path = tuple[str | int, ...]

ATTEMPTS = 1500  # of one finding: a few seconds, since an attempt casts one ray


@dataclass
class Budget:
    """How often the shrinker may still try, and until when."""

    attempts: int = ATTEMPTS
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
        """All passes again and again, until none changes anything or the attempts are used up."""
        while any([each(self) for each in passes]):
            pass
        return self.data


def fewer_shapes(shrinker: Shrinker) -> bool:
    """Leave out runs of shapes, long ones first."""
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
    """Leave out what has a default, steps of transforms included."""
    changed = False
    for path, value in list(walk(shrinker.data)):
        is_field = isinstance(path[-1], str) or isinstance(value, dict)
        if is_field and len(path) > 1 and path[0] in ("shape", "camera") and path[-1] != "type":
            changed |= exists(shrinker.data, path) and shrinker.accepts(without(shrinker.data, path))
    return changed


def rounder_numbers(shrinker: Shrinker) -> bool:
    """Each number by the simplest that will do."""
    changed = False
    for path, value in list(walk(shrinker.data)):
        if isinstance(value, float) and path[0] in ("shape", "camera", "ray"):
            changed |= any(
                shrinker.accepts(with_value(shrinker.data, path, number)) for number in simpler(value)
            )
    return changed


def walk(value: Any, path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Everything in it, containers before what they hold."""
    if path:
        yield path, value
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield from walk(item, (*path, key))


def exists(data: Any, path: Path) -> bool:
    for key in path:
        if isinstance(data, dict):
            if key not in data:
                return False
        elif not isinstance(data, list) or not isinstance(key, int) or key >= len(data):
            return False
        data = data[key]
    return True


def with_value(data: Data, path: Path, value: Any) -> Data:
    """A copy with another value there."""
    out = copy.deepcopy(data)
    _holder(out, path)[path[-1]] = value
    return out


def without(data: Data, path: Path) -> Data:
    """A copy in which this is not there."""
    out = copy.deepcopy(data)
    del _holder(out, path)[path[-1]]
    return out


def _holder(data: Any, path: Path) -> Any:
    for key in path[:-1]:
        data = data[key]
    return data

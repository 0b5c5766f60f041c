"""Registry of AOVs. One file each, which declares:

NAME, CHANNELS: of the AOV, and of its channels in an EXR file; one channel is an image (h, w), more are (h, w, c).
DTYPE, MISS: np.float64 (images have the requested dtype) or np.int32; the value where nothing is hit.
NEEDS: fields of `caster.kernels.surface.per_hit.Hit` beyond the ray and t; what no AOV needs is not computed.
PREVIEW: how its image is coloured, a key of `caster.image.previews.COLORINGS`.
evaluate(hit): the per-hit kernel; a number, or a tuple with one for each channel.

An AOV from elsewhere is added by `register` and rendered like these.
"""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np

from caster.aovs import albedo, depth, diffuse, hit, normal, position, prim_id, shading_normal, shape_id, uv
from caster.jit.decorators import implement, inlined
from caster.kernels.surface.per_hit import NEEDED_FIELDS, per_hit

__all__ = ["AOVS", "BY_NAME", "Aov", "Aovs", "kernel_of", "needs_of", "register", "unregister"]


class Aov(Protocol):
    """A module, or anything else with these attributes."""

    NAME: str
    CHANNELS: tuple[str, ...]
    DTYPE: type[np.generic]
    MISS: float
    NEEDS: tuple[str, ...]
    PREVIEW: str

    def evaluate(self, hit: Any) -> Any: ...


class Aovs(Mapping[str, np.ndarray]):
    """Images by AOV name, (h, w) or (h, w, c) each. `hit` is always there."""

    def __init__(self, images: Mapping[str, np.ndarray], hit: np.ndarray):
        self._images = dict(images)
        self.hit = hit  # (h, w) bool

    def __getitem__(self, name: str) -> np.ndarray:
        return self._images[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._images)

    def __len__(self) -> int:
        return len(self._images)


class PerHit(NamedTuple):
    """What `per_hit` takes first; each AOV has a class derived from it."""

    miss: float
    misses: tuple[float, ...]  # the same for each channel


AOVS: list[Aov] = []
BY_NAME: dict[str, Aov] = {}
_KERNELS: dict[str, Any] = {}


def register(aov: Any) -> None:
    """Add an AOV. Raises ValueError for a declaration that is incomplete, or clashes with another."""
    missing = [name for name in (*Aov.__annotations__, "evaluate") if not hasattr(aov, name)]
    if missing:
        raise ValueError(f"aov {getattr(aov, 'NAME', aov)!r}: does not declare {', '.join(missing)}")
    taken = {"A", *(channel for other in AOVS for channel in other.CHANNELS)} - ({"A"} if aov is hit else set())
    if aov.NAME in BY_NAME or taken & set(aov.CHANNELS):
        raise ValueError(f"aov {aov.NAME!r}: this name or one of its channels {aov.CHANNELS} is taken")
    if unknown := set(aov.NEEDS) - set(NEEDED_FIELDS):
        raise ValueError(f"aov {aov.NAME!r}: needs {sorted(unknown)}; known are {', '.join(NEEDED_FIELDS)}")
    if aov.DTYPE not in (np.float64, np.int32) or not aov.CHANNELS:
        raise ValueError(f"aov {aov.NAME!r}: DTYPE must be float64 or int32, and CHANNELS not empty")
    _KERNELS[aov.NAME] = _kernel(aov)
    AOVS.append(aov)
    BY_NAME[aov.NAME] = aov


def unregister(name: str) -> None:
    """Remove an AOV."""
    AOVS.remove(BY_NAME.pop(name))
    del _KERNELS[name]


def kernel_of(name: str) -> Any:
    """What `per_hit` and `write_aov` take for an AOV: a NamedTuple of a class of its own, with `miss`."""
    return _KERNELS[name]


def needs_of(names: Any) -> frozenset[str]:
    """All fields that some of these AOVs need."""
    return frozenset(field for name in names for field in BY_NAME[name].NEEDS)


def _kernel(aov: Any) -> Any:
    """Compiled kernels are keyed by the classes of their arguments, so each AOV gets a class."""
    name, number = f"PerHit_{aov.NAME}", int if aov.DTYPE is np.int32 else float
    module = getattr(aov, "__name__", type(aov).__module__)
    tag: Any = type(name, (PerHit,), {"__module__": module})
    if module.startswith(f"{__name__}."):
        setattr(aov, name, tag)  # Numba's cache finds it by its name
    evaluate = inlined(aov.evaluate)

    def body(aov: Any, hit: Any) -> Any:
        return evaluate(hit)

    implement(per_hit, tag)(body)
    miss = number(aov.MISS)
    return tag(miss, (miss,) * len(aov.CHANNELS))


for each in (hit, depth, normal, shading_normal, position, uv, albedo, diffuse, shape_id, prim_id):
    register(each)

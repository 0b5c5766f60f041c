"""The AOVs that can be rendered. An AOV from elsewhere is added by `register` and rendered like these."""

import math
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from caster.jit.decorators import implement, inlined
from caster.kernels.surface.per_hit import NEEDED_FIELDS, Hit, length, per_hit

__all__ = ["AOVS", "BY_NAME", "Aovs", "register"]


class Aov(NamedTuple):
    """The declaration of an AOV."""

    NAME: str
    CHANNELS: tuple[str, ...]  # in an EXR file; with one channel images are (h, w), with more (h, w, c)
    DTYPE: type[np.generic]  # np.float64 (images then have the requested dtype) or np.int32
    MISS: float  # the value where nothing is hit
    NEEDS: tuple[str, ...]  # fields of `Hit` beyond the ray and t; what no AOV needs is not computed
    PREVIEW: str  # how its image is coloured, a key of `caster.image.previews.COLORINGS`
    evaluate: Callable[[Any], Any]  # the per-hit kernel: a number, or a tuple with one for each channel


class Aovs(dict[str, NDArray[Any]]):
    """Images by AOV name; `aovs.depth` is `aovs["depth"]`, if that was rendered.

    Floats are float64, or float32 on request. What misses has depth inf, ids -1 and 0 everywhere else.
    """

    hit: NDArray[np.bool_]  # (h, w), always there; aovs["hit"] is the same as 0.0 and 1.0
    depth: NDArray[np.float64]  # (h, w), scene units from the eye along the ray
    normal: NDArray[np.float64]  # (h, w, 3), geometric, outwards, of length 1
    shading_normal: NDArray[np.float64]  # (h, w, 3), between the vertex normals of a mesh, of length 1
    position: NDArray[np.float64]  # (h, w, 3), scene units, in world space
    uv: NDArray[np.float64]  # (h, w, 2), surface coordinates
    albedo: NDArray[np.float64]  # (h, w, 3), diffuse reflectance, 0 to 1
    diffuse: NDArray[np.float64]  # (h, w, 3), reflected radiance, W/(m^2 sr)
    shape_id: NDArray[np.int32]  # (h, w), index of the shape in the scene
    prim_id: NDArray[np.int32]  # (h, w), index of the primitive in its shape

    def __init__(self, images: Mapping[str, NDArray[Any]], hit: NDArray[np.bool_]):
        super().__init__(images)
        self.hit = hit

    if not TYPE_CHECKING:  # so that type checkers report misspelt names

        def __getattr__(self, name: str) -> NDArray[Any]:
            if name in self:
                return self[name]
            (meant,) = get_close_matches(name, BY_NAME, n=1) or [""]
            hint = f", did you mean '{meant}'?" if meant else ""
            hint = f": render it, aovs=({name!r}, ...)" if meant == name else hint
            raise AttributeError(f"no '{name}' among these AOVs ({', '.join(self)}){hint}")

    def __repr__(self) -> str:
        height, width = self.hit.shape
        return f"Aovs({', '.join(self)}: {width} x {height} pixels, {int(self.hit.sum())} hit)"


class PerHit(NamedTuple):
    """The first argument of `per_hit`; each AOV has a class derived from it."""

    miss: float
    misses: tuple[float, ...]  # the same for each channel


AOVS: list[Aov] = []
BY_NAME: dict[str, Aov] = {}
KERNELS: dict[str, Any] = {}  # by name: the argument of `per_hit` and `write_aov` for an AOV, a PerHit of its own class


def register(aov: Aov) -> None:
    """Add an AOV. Raises ValueError for one that is invalid or clashes with another."""
    if aov.NAME in BY_NAME or {channel for other in AOVS for channel in other.CHANNELS} & set(aov.CHANNELS):
        raise ValueError(f"aov {aov.NAME!r}: this name or one of its channels {aov.CHANNELS} is taken")
    if unknown := set(aov.NEEDS) - set(NEEDED_FIELDS):
        raise ValueError(f"aov {aov.NAME!r}: needs {sorted(unknown)}; known are {', '.join(NEEDED_FIELDS)}")
    if aov.DTYPE not in (np.float64, np.int32) or not aov.CHANNELS:
        raise ValueError(f"aov {aov.NAME!r}: DTYPE must be float64 or int32, and CHANNELS not empty")
    # compiled kernels are keyed by the classes of their arguments, so each AOV gets a class
    tag: Any = type(f"PerHit_{aov.NAME}", (PerHit,), {"__module__": aov.evaluate.__module__})
    evaluate = inlined(aov.evaluate)

    @implement(per_hit, tag)
    def body(aov: Any, hit: Any) -> Any:
        return evaluate(hit)

    miss = int(aov.MISS) if aov.DTYPE is np.int32 else float(aov.MISS)
    KERNELS[aov.NAME] = tag(miss, (miss,) * len(aov.CHANNELS))
    AOVS.append(aov)
    BY_NAME[aov.NAME] = aov


# ---- the AOVs ----


def _depth(hit: Hit) -> float:
    """Distance from the eye along the ray, in scene units; also from the eye where a near plane hides a part."""
    return hit.start + hit.t * length(hit.d)


def _field(name: str, parts: str, preview: str, evaluate: Callable[[Any], Any]) -> Aov:
    """The AOV of a field of the same name, with a channel for each of its parts, and 0 on a miss."""
    return Aov(name, tuple(f"{name}.{part}" for part in parts), np.float64, 0.0, (name,), preview, evaluate)


for each in (
    Aov("hit", ("A",), np.float64, 0.0, (), "mask", lambda hit: 1.0),
    Aov("depth", ("depth.Z",), np.float64, math.inf, (), "depth", _depth),
    _field("normal", "XYZ", "direction", lambda hit: hit.normal),
    _field("shading_normal", "XYZ", "direction", lambda hit: hit.shading_normal),
    _field("position", "XYZ", "ranges", lambda hit: hit.position),
    _field("uv", "UV", "ranges", lambda hit: hit.uv),
    _field("albedo", "RGB", "reflectance", lambda hit: hit.albedo),
    Aov("diffuse", ("R", "G", "B"), np.float64, 0.0, ("radiance",), "radiance", lambda hit: hit.radiance),
    Aov("shape_id", ("id.shape",), np.int32, -1, ("shape_id",), "ids", lambda hit: hit.shape_id),
    Aov("prim_id", ("id.prim",), np.int32, -1, ("prim_id",), "ids", lambda hit: hit.prim_id),
):
    register(each)

"""Our own surface, held to float64: what exact arithmetic does not speak of once the primitive and its t are right."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from caster.geometry.packing import Packed
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import Bounds, aov_rows, row_distance
from mitsuba_ref.error_model.intersections import KU_OURS
from mitsuba_ref.subjects.ours import COMPARED_AOVS, ImagePair


class SelfCheck(NamedTuple):
    """One quantity at all pixels."""

    name: str
    error: np.ndarray  # (n,) how far ours is from our own primitive's
    bound: np.ndarray  # (n,) what float64 allows
    counts: np.ndarray  # (n,) bool: where it is held to that

    @property
    def beyond(self) -> np.ndarray:
        """(n,) bool."""
        found: np.ndarray = self.counts & ~(self.error <= self.bound)
        return found

    def is_beyond(self, row: int) -> bool:
        """At one of them."""
        return bool(self.counts[row]) and not self.error[row] <= self.bound[row]


def self_checks(pair: ImagePair, bounds: Bounds, point: np.ndarray) -> Iterator[SelfCheck]:
    """Normals and position of the pixels that we hit. point: (n, 3) o + t d.

    Where float64 does not resolve t, the point and the shading normal, which follow from it, are not held to anything;
    the geometric normal is.
    """
    own, hit = bounds.own, pair.prim >= 0
    resolved = hit & np.isfinite(own.t_error)
    yield SelfCheck("normal", row_distance(aov_rows(pair.ours, "normal"), own.n), own.n_error, hit)
    yield SelfCheck(
        "shading_normal",
        row_distance(aov_rows(pair.ours, "shading_normal"), own.sh_n),
        own.sh_error,
        resolved,
    )
    yield SelfCheck("position", row_distance(aov_rows(pair.ours, "position"), point), own.p_error, resolved)


def fails_self_check(held: Sequence[SelfCheck]) -> np.ndarray:
    """(n,) bool: pixels where something of ours is farther from our primitive's than float64 allows."""
    found: np.ndarray = np.any([each.beyond for each in held], axis=0)
    return found


# What our picture may not contradict, whatever rounding allows the other side: our own hits.


# What each AOV says on a miss, a second time; all others say 0.
MISS_VALUES = {"depth": np.inf, "shape_id": -1, "prim_id": -1}


def inconsistent_aovs(scene: Scene, packed: Packed, pair: ImagePair) -> dict[str, np.ndarray]:
    """Where our AOVs contradict our hits, (n,) bool, by the check that tells of it.

    Not finite on a hit, a value on a miss, a depth, mask, primitive or albedo that does not follow from the hit.
    """
    hit = np.isfinite(pair.t)
    found = {name: ~_fits_the_mask(pair, name, hit) for name in COMPARED_AOVS}
    found["depth"] |= hit & ~_depth_follows(pair)
    found["mask"] = (pair.ours.hit.ravel() != hit) | (aov_rows(pair.ours, "hit") != hit)
    shape = aov_rows(pair.ours, "shape_id")
    first = packed.first[np.maximum(shape, 0)]
    found["shape_id"] |= aov_rows(pair.ours, "prim_id") != np.where(
        hit, pair.prim - first, MISS_VALUES["prim_id"]
    )
    colors = np.array([scene.material_of(each).reflectance for each in scene.shapes]).reshape(-1, 3)
    albedo = np.where(hit[:, None], colors[shape], 0.0) if len(colors) else np.zeros((len(hit), 3))
    found["diffuse"] |= (aov_rows(pair.ours, "albedo") != albedo).any(axis=1)
    return found


def _fits_the_mask(pair: ImagePair, name: str, hit: np.ndarray) -> np.ndarray:
    values = aov_rows(pair.ours, name).reshape(len(hit), -1)
    on_hit, on_miss = np.isfinite(values).all(axis=1), (values == MISS_VALUES.get(name, 0)).all(axis=1)
    return np.where(hit, on_hit, on_miss)


def _depth_follows(pair: ImagePair) -> np.ndarray:
    """Depth is the distance from the eye: where the ray starts, and t of its lengths; rounded three times."""
    expected = pair.rays.start + pair.t * pair.length
    with np.errstate(invalid="ignore"):
        close: np.ndarray = np.abs(aov_rows(pair.ours, "depth") - expected) <= KU_OURS * np.abs(expected)
    return close

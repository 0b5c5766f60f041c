"""What our picture may not contradict, whatever rounding allows the other side: our own hits."""

import numpy as np

from caster.packing import Packed
from caster.scene import Scene
from mitsuba_ref.meeting import KU_OURS
from mitsuba_ref.pair import COMPARED, Pair
from mitsuba_ref.pixels import flat

# What each AOV says on a miss, a second time; all others say 0.
MISS = {"depth": np.inf, "shape_id": -1, "prim_id": -1}


def contradictions(scene: Scene, packed: Packed, pair: Pair) -> dict[str, np.ndarray]:
    """Where our AOVs contradict our hits, (n,) bool, by the check that tells of it.

    Not finite on a hit, a value on a miss, a depth, mask, primitive or albedo that does not follow from the hit.
    """
    hit = np.isfinite(pair.t)
    found = {name: ~_fits_the_mask(pair, name, hit) for name in COMPARED}
    found["depth"] |= hit & ~_depth_follows(pair)
    found["mask"] = (pair.ours.hit.ravel() != hit) | (flat(pair.ours, "hit") != hit)
    shape = flat(pair.ours, "shape_id")
    first = packed.first[np.maximum(shape, 0)]
    found["shape_id"] |= flat(pair.ours, "prim_id") != np.where(hit, pair.prim - first, MISS["prim_id"])
    colors = np.array([scene.material_of(each).reflectance for each in scene.shapes]).reshape(-1, 3)
    albedo = np.where(hit[:, None], colors[shape], 0.0) if len(colors) else np.zeros((len(hit), 3))
    found["diffuse"] |= (flat(pair.ours, "albedo") != albedo).any(axis=1)
    return found


def _fits_the_mask(pair: Pair, name: str, hit: np.ndarray) -> np.ndarray:
    values = flat(pair.ours, name).reshape(len(hit), -1)
    on_hit, on_miss = np.isfinite(values).all(axis=1), (values == MISS.get(name, 0)).all(axis=1)
    return np.where(hit, on_hit, on_miss)


def _depth_follows(pair: Pair) -> np.ndarray:
    """Depth is the distance from the eye: where the ray starts, and t of its lengths; rounded three times."""
    expected = pair.rays.start + pair.t * pair.length
    with np.errstate(invalid="ignore"):
        close: np.ndarray = np.abs(flat(pair.ours, "depth") - expected) <= KU_OURS * np.abs(expected)
    return close

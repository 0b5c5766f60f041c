"""ours - reference as an EXR file of its own, with a class for each pixel."""

import os

import numpy as np

from caster.exr import write_exr
from mitsuba_ref.exr.differences import Judged
from mitsuba_ref.exr.layers import Array
from mitsuba_ref.exr.pairs import Pair

LARGEST = float(np.finfo(np.float32).max)  # what an EXR channel holds

MISS, AGREE, DIFFER, HIT_MISS, NON_FINITE = range(5)
CLASSES = "0 missed by both, 1 hit by both and agrees, 2 differs, 3 hit in one image only, 4 not finite"


def write_difference(
    path: str | os.PathLike[str], pair: Pair, judged: list[Judged], ours: str, reference: str
) -> None:
    """Each channel's difference under its own name, float32, and `class.I`; ours, reference: what was read.

    Raises OutputError.
    """
    channels = {name: _signed(pair, name) for name in pair.names}
    channels["class.I"] = _classes(pair, judged).astype(np.uint32)
    about = {"kind": "ours minus reference", "class": CLASSES, "ours": ours, "reference": reference}
    data, display = pair.reference.data_window, pair.reference.display_window
    write_exr(path, channels, about, data_window=data, display_window=display)


def _signed(pair: Pair, name: str) -> Array:
    a, b = (values[..., 0] for values in pair.values([name]))
    with np.errstate(invalid="ignore"):
        signed = np.where(a == b, 0.0, a - b)  # inf on both sides is no difference
    return np.where(np.isfinite(signed), np.clip(signed, -LARGEST, LARGEST), signed)


def _classes(pair: Pair, judged: list[Judged]) -> Array:
    classes = np.where(pair.hit_ours | pair.hit_reference, AGREE, MISS)
    classes[np.any([j.differ for j in judged], axis=0)] = DIFFER
    classes[~pair.same_mask] = HIT_MISS
    classes[np.any([j.broken for j in judged], axis=0)] = NON_FINITE
    return classes

"""Where two images differ: each quantity judged pixel by pixel."""

from typing import NamedTuple

import numpy as np

from mitsuba_ref.exr.bounds import bound_of
from mitsuba_ref.exr.layers import LAYERS, Array
from mitsuba_ref.exr.pairs import Pair
from mitsuba_ref.exr.result import GroupResult, Worst
from mitsuba_ref.exr.tolerances import Tolerances


class Judged(NamedTuple):
    """One quantity, and the pixels in which it differs."""

    result: GroupResult
    differ: Array  # (h, w) bool
    broken: Array  # (h, w) bool: a value is not finite and should be


def present_groups(names: list[str]) -> list[tuple[str, tuple[str, ...]]]:
    """The groups that are there, in the order of LAYERS, then every other channel by itself; not `hit`."""
    known = [(group, tuple(n for n in layer if n in names)) for group, layer in LAYERS.items()]
    listed = {n for layer in LAYERS.values() for n in layer}
    groups = known + [(n, (n,)) for n in names if n not in listed]
    return [(group, members) for group, members in groups if members and group != "hit"]


def judge_hits(pair: Pair) -> Judged:
    """Which pixels only one image hits; channel A, where there is one, is compared value by value."""
    differ, broken = ~pair.same_mask, np.zeros(pair.hit_ours.shape, bool)
    a, b = pair.hit_ours[..., None].astype(np.float64), pair.hit_reference[..., None].astype(np.float64)
    if "A" in pair.names:
        a, b = pair.values(["A"])
        broken = ~np.isfinite(a[..., 0]) | ~np.isfinite(b[..., 0])
        differ = (differ | (a != b)[..., 0]) & ~broken
    worst = _worst(pair, (pair.mask_channel,), a, b, np.zeros_like(b), (differ | broken)[..., None])
    counts = _counts(pair, differ, broken)
    return Judged(GroupResult("hit", (pair.mask_channel,), "exact", *counts, worst), differ, broken)


def judge(pair: Pair, group: str, names: tuple[str, ...], tol: Tolerances) -> Judged:
    """One quantity against its bound, in every pixel that both images hit or both miss."""
    a, b = pair.values(names)
    bound, text = bound_of(pair, group, names, tol)
    far_a = _depth_of_a_miss(group, a, pair.hit_ours)
    far_b = _depth_of_a_miss(group, b, pair.hit_reference)
    same = pair.same_mask[..., None]
    broken = (~np.isfinite(a) & ~far_a) | (~np.isfinite(b) & ~far_b) | ((far_a != far_b) & same)
    with np.errstate(invalid="ignore"):  # inf - inf and NaN: both are in `broken`, or both images miss
        within = (np.abs(a - b) <= bound) | (far_a & far_b)
    differ = ~within & ~broken & same  # "not within", so that a NaN can never pass as "not beyond"
    worst = _worst(pair, names, a, b, bound, (same & ~(far_a & far_b)) | broken)
    differing, unusable = differ.any(-1) & ~broken.any(-1), broken.any(-1)
    counts = _counts(pair, differing, unusable)
    return Judged(GroupResult(group, names, text, *counts, worst), differing, unusable)


def _counts(pair: Pair, differ: Array, broken: Array) -> tuple[int, int, int]:
    agree = pair.hit_ours & pair.hit_reference & ~differ & ~broken
    return int(agree.sum()), int(differ.sum()), int(broken.sum())


def _depth_of_a_miss(group: str, values: Array, hit: Array) -> Array:
    """The only infinity that means something: the depth of a ray that hits nothing."""
    return np.asarray((values == np.inf) & ~hit[..., None] & (group == "depth"))


def _worst(
    pair: Pair, names: tuple[str, ...], a: Array, b: Array, bound: Array, eligible: Array
) -> Worst | None:
    with np.errstate(all="ignore"):
        error = np.abs(a - b)
        ratio = np.where(error == 0.0, 0.0, error / bound)
    ratio = np.where(eligible, np.nan_to_num(ratio, nan=np.inf), 0.0)
    y, x, c = (int(i) for i in np.unravel_index(int(ratio.argmax()), ratio.shape))
    if ratio[y, x, c] == 0.0:
        return None
    x0, y0 = pair.reference.data_window[:2]
    numbers = (float(values[y, x, c]) for values in (a, b, error, bound))
    return Worst(names[c], x0 + x, y0 + y, *numbers)

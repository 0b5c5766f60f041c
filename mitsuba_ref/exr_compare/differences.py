"""Pixels in which two EXR files differ: each quantity against its bound, (h, w, c), and the text that states it."""

from typing import NamedTuple

import numpy as np

from caster.image.exr import Exr
from mitsuba_ref.error_model.tolerances import (
    COLOR_RTOL,
    DEPTH_RTOL,
    HALF_ROUNDINGS,
    LARGEST_FIRST_ORDER_SHARE,
    NORMAL_ATOL,
    SMALLEST_HALF,
    TYPICAL_ATOL,
    U32,
    U_HALF,
    Tolerances,
)
from mitsuba_ref.exr_compare.comparison_result import GroupResult, Worst
from mitsuba_ref.exr_compare.exr_pair import LAYERS, Array, Conditioning, ExrPair, stacked

DERIVED = "K u S / cos"

Bound = tuple[Array, str]


def bound_of(pair: ExrPair, group: str, names: tuple[str, ...], tol: Tolerances) -> Bound:
    """The bound of one quantity: the given tolerance, else the derived one, else the plain one."""
    a, b = pair.values(names)
    if any(pair.reference.channels[name].dtype == np.uint32 for name in names):
        return np.zeros_like(b), "exact"
    with np.errstate(all="ignore"):  # values that are not finite are judged before any bound
        halves = _half_precision_error(pair.ours, names, a) + _half_precision_error(pair.reference, names, b)
        stored = U32 * (np.abs(a) + np.abs(b)) + halves
        if group in ("depth", "position"):
            bound, text = _length_bound(pair, group, tol, stored, b)
        elif group in ("normal", "shading_normal"):
            bound, text = _normal_bound(pair.condition, tol, stored, b)
        else:
            bound, text = _shade_bound(pair.condition, group, tol, stored, b)
        return (bound, f"{text} + half") if halves.any() and "as given" not in text else (bound, text)


def _half_precision_error(exr: Exr, names: tuple[str, ...], values: Array) -> Array:
    """Rounding error of values that were stored as halves, 0 for others."""
    half = np.array([exr.channels[name].dtype == np.float16 for name in names])
    return np.where(half, HALF_ROUNDINGS * np.maximum(U_HALF * np.abs(values), SMALLEST_HALF / 2.0), 0.0)


def _length_bound(pair: ExrPair, group: str, tol: Tolerances, stored: Array, b: Array) -> Bound:
    condition = pair.condition
    size = np.abs(b).max(-1, keepdims=True)
    if group == "position":  # a hit near the world's origin errs by as much as its ray does
        size = np.maximum(size, _finite_depth(pair.reference, default=_typical_magnitude(b)))
    if tol.depth_rtol is not None:
        return np.broadcast_to(tol.depth_rtol * size, b.shape), f"{tol.depth_rtol:.3g} relative, as given"
    plain = stored + DEPTH_RTOL * size
    if condition is None:
        return plain, f"{DEPTH_RTOL:.2g} relative (per pixel with camera, depth, normal and position)"
    first_order = (condition.depth_error if group == "depth" else condition.position_error)[..., None]
    derived = np.where(first_order < LARGEST_FIRST_ORDER_SHARE * size, stored + first_order, plain)
    return derived, DERIVED if group == "depth" else "K u S (1 + 1/cos)"


def _finite_depth(exr: Exr, default: float) -> Array | float:
    if "depth.Z" not in exr.channels:
        return default
    t = stacked(exr, ["depth.Z"])
    return np.where(np.isfinite(t), np.abs(t), 0.0)


def _normal_bound(condition: Conditioning | None, tol: Tolerances, stored: Array, b: Array) -> Bound:
    if tol.normal_atol is not None:
        return np.full_like(b, tol.normal_atol), f"{tol.normal_atol:.3g}, as given"
    return _bound_at_displaced_hit(condition, b, stored + NORMAL_ATOL, 1.0, f"{NORMAL_ATOL:.2g}")


def _shade_bound(
    condition: Conditioning | None, group: str, tol: Tolerances, stored: Array, b: Array
) -> Bound:
    typical = _typical_magnitude(b)
    given = (0.0, tol.uv_atol) if group == "uv" else (tol.color_rtol, tol.color_atol)
    rtol = (0.0 if group == "uv" else COLOR_RTOL) if given[0] is None else given[0]
    atol = TYPICAL_ATOL * typical if given[1] is None else given[1]
    plain, text = rtol * np.abs(b) + atol, f"{rtol:.2g} relative + {atol:.2g}"
    if given not in ((0.0, None), (None, None)):
        return plain, f"{text}, as given"
    return _bound_at_displaced_hit(condition, b, stored + plain, typical, text)


def _typical_magnitude(values: Array) -> float:
    known = np.abs(values[np.isfinite(values) & (values != 0.0)])
    return float(np.median(known)) if known.size else 0.0


def _bound_at_displaced_hit(
    condition: Conditioning | None, field: Array, plain: Array, scale: float, text: str
) -> Bound:
    """A field over the surface is evaluated at the hit: add its slope times the position error."""
    if condition is None:
        return plain, text
    lever = (_surface_slope(field, condition) * condition.position_error)[..., None]
    return plain + np.where(
        lever < LARGEST_FIRST_ORDER_SHARE * scale, lever, 0.0
    ), f"{text} + slope K u S (1 + 1/cos)"


def _surface_slope(field: Array, condition: Conditioning) -> Array:
    """Largest |step of field| / |step of position| to the four neighbours on the same surface; (h, w).

    0 without a neighbour: a surface visible in a single pixel gets the plain bound.
    """
    steepest = np.zeros(field.shape[:2])
    for axis in (0, 1):
        rise = np.linalg.norm(np.diff(field, axis=axis), axis=-1)
        run = np.linalg.norm(np.diff(condition.position, axis=axis), axis=-1)
        known = (np.diff(condition.surface, axis=axis) == 0.0) & (run > 0.0) & np.isfinite(rise)
        step = np.where(known, rise / run, 0.0)
        for side in ((0, 1), (1, 0)):  # a step belongs to the pixels at both of its ends
            steepest = np.maximum(steepest, np.pad(step, [side, (0, 0)] if axis == 0 else [(0, 0), side]))
    return steepest


class Judged(NamedTuple):
    """One quantity, and the pixels in which it differs."""

    result: GroupResult
    differ: Array  # (h, w) bool
    broken: Array  # (h, w) bool: a value is not finite and should be


def present_groups(names: list[str]) -> list[tuple[str, tuple[str, ...]]]:
    """The groups that are present, in the order of LAYERS, then every other channel by itself; not `hit`."""
    known = [(group, tuple(n for n in layer if n in names)) for group, layer in LAYERS.items()]
    listed = {n for layer in LAYERS.values() for n in layer}
    groups = known + [(n, (n,)) for n in names if n not in listed]
    return [(group, members) for group, members in groups if members and group != "hit"]


def judge_hits(pair: ExrPair) -> Judged:
    """Pixels that only one image hits; channel A, where there is one, is compared value by value."""
    differ, broken = ~pair.same_mask, np.zeros(pair.hit_ours.shape, bool)
    a, b = pair.hit_ours[..., None].astype(np.float64), pair.hit_reference[..., None].astype(np.float64)
    if "A" in pair.names:
        a, b = pair.values(["A"])
        broken = ~np.isfinite(a[..., 0]) | ~np.isfinite(b[..., 0])
        differ = (differ | (a != b)[..., 0]) & ~broken
    worst = _worst(pair, (pair.mask_channel,), a, b, np.zeros_like(b), (differ | broken)[..., None])
    counts = _counts(pair, differ, broken)
    return Judged(_group("hit", (pair.mask_channel,), "exact", counts, worst), differ, broken)


def judge(pair: ExrPair, group: str, names: tuple[str, ...], tol: Tolerances) -> Judged:
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
    return Judged(_group(group, names, text, counts, worst), differing, unusable)


def _group(
    name: str, channels: tuple[str, ...], bound: str, counts: tuple[int, int, int], worst: Worst | None
) -> GroupResult:
    agree, differ, non_finite = counts
    return GroupResult(
        name=name,
        channels=channels,
        bound=bound,
        agree=agree,
        differ=differ,
        non_finite=non_finite,
        worst=worst,
    )


def _counts(pair: ExrPair, differ: Array, broken: Array) -> tuple[int, int, int]:
    agree = pair.hit_ours & pair.hit_reference & ~differ & ~broken
    return int(agree.sum()), int(differ.sum()), int(broken.sum())


def _depth_of_a_miss(group: str, values: Array, hit: Array) -> Array:
    """Where infinity is a valid value: the depth of a ray that hits nothing."""
    return np.asarray((values == np.inf) & ~hit[..., None] & (group == "depth"))


def _worst(
    pair: ExrPair, names: tuple[str, ...], a: Array, b: Array, bound: Array, eligible: Array
) -> Worst | None:
    with np.errstate(all="ignore"):
        error = np.abs(a - b)
        ratio = np.where(error == 0.0, 0.0, error / bound)
    ratio = np.where(eligible, np.nan_to_num(ratio, nan=np.inf), 0.0)
    y, x, c = (int(i) for i in np.unravel_index(int(ratio.argmax()), ratio.shape))
    if ratio[y, x, c] == 0.0:
        return None
    x0, y0 = pair.reference.data_window[:2]
    return Worst(
        channel=names[c],
        x=x0 + x,
        y=y0 + y,
        ours=float(a[y, x, c]),
        reference=float(b[y, x, c]),
        error=float(error[y, x, c]),
        bound=float(bound[y, x, c]),
    )

"""The allowed |ours - reference| of each value, (h, w, c), and the words that state it."""

import numpy as np

from caster.image.exr import Exr
from mitsuba_ref.error_model.exr_tolerances import (
    COLOR_RTOL,
    DEPTH_RTOL,
    NORMAL_ATOL,
    TYPICAL_ATOL,
    UNRESOLVABLE,
    Tolerances,
)
from mitsuba_ref.error_model.intersections import U
from mitsuba_ref.exr_compare.conditioning import Conditioning
from mitsuba_ref.exr_compare.exr_layers import Array, stacked
from mitsuba_ref.exr_compare.exr_pair import ExrPair

DERIVED = "K u S / cos"

# A half has 11 bits, and below 2^-14 the spacing stays 2^-24. It was rounded once as it was stored, and where depth was
# made into a distance, a second time.
HALF_ROUNDINGS = 2.0
U_HALF, SMALLEST_HALF = 2.0**-11, 2.0**-24

Bound = tuple[Array, str]


def bound_of(pair: ExrPair, group: str, names: tuple[str, ...], tol: Tolerances) -> Bound:
    """The bound of one quantity: what was asked for, else what can be derived, else the plain tolerance."""
    a, b = pair.values(names)
    if any(pair.reference.channels[name].dtype == np.uint32 for name in names):
        return np.zeros_like(b), "exact"
    with np.errstate(all="ignore"):  # values that are not finite are judged before any bound
        halves = _half_precision_error(pair.ours, names, a) + _half_precision_error(pair.reference, names, b)
        stored = U * (np.abs(a) + np.abs(b)) + halves
        if group in ("depth", "position"):
            bound, text = _length_bound(pair, group, tol, stored, b)
        elif group in ("normal", "shading_normal"):
            bound, text = _normal_bound(pair.condition, tol, stored, b)
        else:
            bound, text = _shade_bound(pair.condition, group, tol, stored, b)
        return (bound, f"{text} + half") if halves.any() and "as asked" not in text else (bound, text)


def _half_precision_error(exr: Exr, names: tuple[str, ...], values: Array) -> Array:
    """How far values are off that were stored as halves, 0 for others."""
    half = np.array([exr.channels[name].dtype == np.float16 for name in names])
    return np.where(half, HALF_ROUNDINGS * np.maximum(U_HALF * np.abs(values), SMALLEST_HALF / 2.0), 0.0)


def _length_bound(pair: ExrPair, group: str, tol: Tolerances, stored: Array, b: Array) -> Bound:
    condition = pair.condition
    size = np.abs(b).max(-1, keepdims=True)
    if group == "position":  # a hit near the world's origin errs by as much as its ray does
        size = np.maximum(size, _finite_depth(pair.reference, default=_typical_magnitude(b)))
    if tol.depth_rtol is not None:
        return np.broadcast_to(tol.depth_rtol * size, b.shape), f"{tol.depth_rtol:.3g} relative, as asked"
    plain = stored + DEPTH_RTOL * size
    if condition is None:
        return plain, f"{DEPTH_RTOL:.2g} relative (per pixel with camera, depth, normal and position)"
    first_order = (condition.depth if group == "depth" else condition.place)[..., None]
    derived = np.where(first_order < UNRESOLVABLE * size, stored + first_order, plain)
    return derived, DERIVED if group == "depth" else "K u S (1 + 1/cos)"


def _finite_depth(exr: Exr, default: float) -> Array | float:
    if "depth.Z" not in exr.channels:
        return default
    t = stacked(exr, ["depth.Z"])
    return np.where(np.isfinite(t), np.abs(t), 0.0)


def _normal_bound(condition: Conditioning | None, tol: Tolerances, stored: Array, b: Array) -> Bound:
    if tol.normal_atol is not None:
        return np.full_like(b, tol.normal_atol), f"{tol.normal_atol:.3g}, as asked"
    return _bound_at_displaced_hit(condition, b, stored + NORMAL_ATOL, 1.0, f"{NORMAL_ATOL:.2g}")


def _shade_bound(
    condition: Conditioning | None, group: str, tol: Tolerances, stored: Array, b: Array
) -> Bound:
    typical = _typical_magnitude(b)
    asked = (0.0, tol.uv_atol) if group == "uv" else (tol.color_rtol, tol.color_atol)
    rtol = (0.0 if group == "uv" else COLOR_RTOL) if asked[0] is None else asked[0]
    atol = TYPICAL_ATOL * typical if asked[1] is None else asked[1]
    plain, text = rtol * np.abs(b) + atol, f"{rtol:.2g} relative + {atol:.2g}"
    if asked not in ((0.0, None), (None, None)):
        return plain, f"{text}, as asked"
    return _bound_at_displaced_hit(condition, b, stored + plain, typical, text)


def _typical_magnitude(values: Array) -> float:
    known = np.abs(values[np.isfinite(values) & (values != 0.0)])
    return float(np.median(known)) if known.size else 0.0


def _bound_at_displaced_hit(
    condition: Conditioning | None, field: Array, plain: Array, scale: float, text: str
) -> Bound:
    """What varies over the surface is read where the hit is: add its slope times the error of the place."""
    if condition is None:
        return plain, text
    lever = (_surface_slope(field, condition) * condition.place)[..., None]
    return plain + np.where(lever < UNRESOLVABLE * scale, lever, 0.0), f"{text} + slope K u S (1 + 1/cos)"


def _surface_slope(field: Array, condition: Conditioning) -> Array:
    """Largest |step of field| / |step of position| to the four neighbours on the same surface; (h, w).

    0 without a neighbour: a surface seen in a single pixel gets the plain bound.
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

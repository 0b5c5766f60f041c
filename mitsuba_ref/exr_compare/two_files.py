"""Comparison of two EXR files pixel by pixel; NaN, renamed channels, another window or a missed pixel never pass.

An EXR holds no primitives, so the bounds of `validate` cannot be derived here. Where the reference carries `position`,
`depth` and `normal` and its provenance names the camera, they give the conditioning of each pixel (magnitude of the
numbers, angle of incidence, curvature) and with it a first-order bound; elsewhere plain tolerances apply. The result
states which it was.
"""

import os
import shlex
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from caster.description.errors import SceneError
from caster.image.exr import Exr, read_exr, write_exr
from caster.system.process import DIFFERENCES, NOTHING_SELECTED, OK
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
from mitsuba_ref.exr_compare.comparison_result import (
    FileComparison,
    GroupResult,
    Worst,
    failing_groups,
    result_messages,
)
from mitsuba_ref.exr_compare.conventions import Reading, Unclear, check_maps, hints, scene_in, to_our_conventions
from mitsuba_ref.exr_compare.exr_pair import (
    LAYERS,
    Array,
    Conditioning,
    ExrPair,
    ignored_channels,
    incompatibilities,
    size_of,
    stacked,
)

__all__ = ["FileComparison", "Reading", "Tolerances", "compare_exr"]

FileName = str | os.PathLike[str]
LARGEST_FLOAT32 = float(np.finfo(np.float32).max)  # what an EXR channel holds
SCENE = "caster/scene"  # provenance: the scene's path

MISS, AGREE, DIFFER, HIT_MISS, NON_FINITE = range(5)
CLASSES = "0 missed by both, 1 hit by both and agrees, 2 differs, 3 hit in one image only, 4 not finite"


class Judged(NamedTuple):
    """One quantity, and the pixels in which it differs."""

    result: GroupResult
    differ: Array  # (h, w) bool
    broken: Array  # (h, w) bool: a value is not finite and should be


def compare_exr(
    ours: FileName,
    reference: FileName,
    tolerances: Tolerances | None = None,
    *,
    diff: FileName | None = None,
    reading: Reading | None = None,
) -> FileComparison:
    """Judge every pixel of two EXR files, by channel name.

    diff: where to write ours - reference under the same channel names, float32, and the uint32 channel
    `class.I` (codes in its provenance); not written when the files are not comparable.
    reading: how to interpret files of other programs.
    Raises FileMissing or UnreadableExr for an input, OutputError for diff, SceneError for an `ignore` that
    names nothing or a diff that would overwrite an input.
    """
    reading, names = reading or Reading(), (str(ours), str(reference))
    files = [read_exr(ours), read_exr(reference)]
    if diff is not None and _same_file(diff, (ours, reference)):
        raise SceneError(f"{diff}: the difference would overwrite an image it compares; give another name")
    check_maps(reading.maps, *(exr.channels for exr in files))
    converted, stated = list[Exr](), list[str]()
    for who, exr, other in zip(SIDES, files, files[::-1], strict=True):
        try:
            found, steps = to_our_conventions(exr, reading, [scene_in(other)])
        except Unclear as question:
            return _not_comparable(_blank(names, stated=tuple(stated)), [f"{who}: {question}"])
        converted.append(found)
        stated += [f"{who}: {step}" for step in steps]
    a, b = converted
    foreign = [i for i in (0, 1) if converted[i] is not files[i]]
    alone = sorted(a.channels.keys() ^ b.channels.keys()) if foreign else []
    stated += [f"not compared, since only one file has them: {', '.join(alone)}"] if alone else []
    result = compare_images(a, b, tolerances, names=names, stated=tuple(stated), left_out=alone, diff=diff)
    if result.exit_code != DIFFERENCES:
        return result
    more = [f"hint:   {SIDES[i]}: {hint}" for i in foreign for hint in hints(converted[i], converted[1 - i], reading)]
    return result.model_copy(update={"messages": (*result.messages, *more)})


SIDES = ("ours", "the reference")


def _blank(names: tuple[str, str], **more: Any) -> FileComparison:
    return FileComparison(ours=names[0], reference=names[1], **more)


def compare_images(
    a: Exr,
    b: Exr,
    tolerances: Tolerances | None = None,
    *,
    names: tuple[str, str] = SIDES,
    stated: tuple[str, ...] = (),
    left_out: Iterable[str] = (),
    diff: FileName | None = None,
) -> FileComparison:
    """Judge every pixel of two images in our conventions. names: of the images; left_out: channels not compared."""
    tolerances = tolerances or Tolerances()
    ignored = ignored_channels(a, b, tolerances.ignore)
    blank = _blank(names, ignored=ignored, stated=stated)
    left_out = {*ignored, *left_out}
    if reasons := incompatibilities(a, b, left_out, other_scene=tolerances.other_scene):
        return _not_comparable(blank, reasons)
    pair = ExrPair.of(a, b, [name for name in a.channels if name not in left_out])
    judged = _judged(pair, tolerances)
    if diff is not None:
        write_difference(diff, pair, judged, *names)
    counted = _counted(blank, pair, judged, tolerances)
    messages = result_messages(counted, len(pair.names), _next_steps(counted, pair, diff))
    return counted.model_copy(update={"messages": tuple(messages)})


def _same_file(path: FileName, others: Iterable[FileName]) -> bool:
    return os.path.exists(path) and any(os.path.samefile(path, other) for other in others)


def _not_comparable(blank: FileComparison, reasons: Iterable[str]) -> FileComparison:
    look = f"next:   caster info {shlex.quote(blank.ours)}; caster info {shlex.quote(blank.reference)}"
    messages = ("NOT COMPARABLE", *(f"      {text}" for text in (*reasons, look)))
    return blank.model_copy(update={"messages": messages})


def _judged(pair: ExrPair, tolerances: Tolerances) -> list[Judged]:
    hits = [judge_hits(pair)] if pair.mask_channel else []
    groups = present_groups(pair.names)
    return hits + [judge(pair, group, names, tolerances) for group, names in groups]


def _is_empty(pair: ExrPair) -> bool:
    """Whether nothing was hit; without a mask channel, whether every number of both images is 0."""
    if pair.mask_channel:
        return not (pair.hit_ours | pair.hit_reference).any()
    return not any(exr.channels[name].any() for exr in (pair.ours, pair.reference) for name in pair.names)


def _counted(blank: FileComparison, pair: ExrPair, judged: list[Judged], tolerances: Tolerances) -> FileComparison:
    broken = np.any([j.broken for j in judged], axis=0)
    bad = int((np.any([j.differ for j in judged], axis=0) | broken).sum())
    failed = bool(broken.any()) or bad > tolerances.max_pixels
    masks = pair.hit_ours, pair.hit_reference, pair.hit_ours | pair.hit_reference
    hits = [int(mask.sum()) for mask in masks] if pair.mask_channel else [None] * 3
    empty = not tolerances.allow_empty and _is_empty(pair)
    width, height = size_of(pair.reference)
    return blank.model_copy(
        update={
            "width": width,
            "height": height,
            "hit_ours": hits[0],
            "hit_reference": hits[1],
            "hit_either": hits[2],
            "differing_pixels": bad,
            "allowed_pixels": tolerances.max_pixels,
            "groups": tuple(each.result for each in judged),
            "exit_code": DIFFERENCES if failed else NOTHING_SELECTED if empty else OK,
        }
    )


def _next_steps(result: FileComparison, pair: ExrPair, diff: FileName | None) -> list[str]:
    """Where to look and the next command, for the first group that fails."""
    group = next(iter(failing_groups(result)), None)
    if group is None:
        return []
    at = f"{group.worst.x} {group.worst.y}" if group.worst else "0 0"
    scene = next(filter(None, (exr.provenance.get(SCENE) for exr in (pair.ours, pair.reference))), "")
    look = f"      look:   {diff}, channel class.I ({CLASSES})"
    replay = f"      replay: mitsuba-ref probe {shlex.quote(scene)} {at}"
    info = f"      next:   caster info {shlex.quote(result.ours)}"
    note = "      note:   rounding decides edges and shadow borders; see validate; --max-pixels N allows them"
    return [*([look] if diff is not None else []), replay if scene and scene.isprintable() else info, note]


def write_difference(path: FileName, pair: ExrPair, judged: list[Judged], ours: str, reference: str) -> None:
    """Each channel's difference under its own name, float32, and `class.I`; ours, reference: what was read.

    Raises OutputError.
    """
    channels = {name: _signed(pair, name) for name in pair.names}
    channels["class.I"] = _classes(pair, judged).astype(np.uint32)
    about = {"kind": "ours minus reference", "class": CLASSES, "ours": ours, "reference": reference}
    data, display = pair.reference.data_window, pair.reference.display_window
    write_exr(path, channels, about, data_window=data, display_window=display)


def _signed(pair: ExrPair, name: str) -> Array:
    a, b = (values[..., 0] for values in pair.values([name]))
    with np.errstate(invalid="ignore"):
        signed = np.where(a == b, 0.0, a - b)  # inf on both sides is no difference
    return np.where(np.isfinite(signed), np.clip(signed, -LARGEST_FLOAT32, LARGEST_FLOAT32), signed)


def _classes(pair: ExrPair, judged: list[Judged]) -> Array:
    classes = np.where(pair.hit_ours | pair.hit_reference, AGREE, MISS)
    classes[np.any([j.differ for j in judged], axis=0)] = DIFFER
    classes[~pair.same_mask] = HIT_MISS
    classes[np.any([j.broken for j in judged], axis=0)] = NON_FINITE
    return classes


# ---- each quantity against its bound, (h, w, c), and the text that states it ----

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
        else:
            bound, text = _surface_bound(pair.condition, group, tol, stored, b)
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


def _surface_bound(condition: Conditioning | None, group: str, tol: Tolerances, stored: Array, b: Array) -> Bound:
    """Of a field over the surface, evaluated at a displaced hit: add its slope times the position error."""
    normal, typical = group in ("normal", "shading_normal"), _typical_magnitude(b)
    if normal or group == "uv":
        given: tuple[float | None, float | None] = (None, tol.normal_atol if normal else tol.uv_atol)
        default = 0.0
    else:
        given, default = (tol.color_rtol, tol.color_atol), COLOR_RTOL
    scale, least = (1.0, NORMAL_ATOL) if normal else (typical, TYPICAL_ATOL * typical)
    rtol, atol = default if given[0] is None else given[0], least if given[1] is None else given[1]
    plain, text = rtol * np.abs(b) + atol, f"{rtol:.2g} relative + {atol:.2g}"
    if given != (None, None):
        return plain, f"{text}, as given"
    if condition is None:
        return stored + plain, text
    lever = (_surface_slope(b, condition) * condition.position_error)[..., None]
    lever = np.where(lever < LARGEST_FIRST_ORDER_SHARE * scale, lever, 0.0)
    return stored + plain + lever, f"{text} + slope K u S (1 + 1/cos)"


def _typical_magnitude(values: Array) -> float:
    known = np.abs(values[np.isfinite(values) & (values != 0.0)])
    return float(np.median(known)) if known.size else 0.0


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
    return _judgement(pair, "hit", (pair.mask_channel,), "exact", differ, broken, worst)


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
    broken = broken.any(-1)
    return _judgement(pair, group, names, text, differ.any(-1) & ~broken, broken, worst)


def _judgement(
    pair: ExrPair, name: str, channels: tuple[str, ...], bound: str, differ: Array, broken: Array, worst: Worst | None
) -> Judged:
    agree = int((pair.hit_ours & pair.hit_reference & ~differ & ~broken).sum())
    counts = {"agree": agree, "differ": int(differ.sum()), "non_finite": int(broken.sum())}
    return Judged(GroupResult(name=name, channels=channels, bound=bound, worst=worst, **counts), differ, broken)


def _depth_of_a_miss(group: str, values: Array, hit: Array) -> Array:
    """Where infinity is a valid value: the depth of a ray that hits nothing."""
    return np.asarray((values == np.inf) & ~hit[..., None] & (group == "depth"))


def _worst(pair: ExrPair, names: tuple[str, ...], a: Array, b: Array, bound: Array, eligible: Array) -> Worst | None:
    with np.errstate(all="ignore"):
        error = np.abs(a - b)
        ratio = np.where(error == 0.0, 0.0, error / bound)
    ratio = np.where(eligible, np.nan_to_num(ratio, nan=np.inf), 0.0)
    among = np.where(ratio == ratio.max(), np.nan_to_num(error, nan=np.inf), -1.0)  # where no error is allowed: largest
    y, x, c = (int(i) for i in np.unravel_index(int(among.argmax()), ratio.shape))
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

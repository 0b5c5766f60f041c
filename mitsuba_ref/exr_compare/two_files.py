"""Comparison of two EXR files pixel by pixel; NaN, renamed channels, another window or a missed pixel never pass."""

import fnmatch
import os
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from caster.description.errors import SceneError, error_prefix, suggestion
from caster.image.exr import Exr, read_exr, write_exr
from caster.system.process import DIFFERENCES, NOTHING_SELECTED, OK
from mitsuba_ref.error_model.tolerances import Tolerances
from mitsuba_ref.exr_compare.comparison_result import (
    AGREE,
    CLASSES,
    DIFFER,
    HIT_MISS,
    MISS,
    NON_FINITE,
    FileComparison,
    GroupResult,
    Worst,
)
from mitsuba_ref.exr_compare.conventions import Reading, check_maps, hints, to_our_conventions
from mitsuba_ref.exr_compare.pixel_bounds import LAYERS, SCENE_HASH, Array, ExrPair, bound_of, scene_in
from mitsuba_ref.report.evidence import clipped_to_float32

__all__ = ["FileComparison", "Reading", "Tolerances", "compare_exr"]

FileName = str | os.PathLike[str]
SIDES = ("ours", "the reference")
SCENE = "caster/scene"  # provenance: the scene's path


def compare_exr(
    ours: FileName,
    reference: FileName,
    tolerances: Tolerances | None = None,
    *,
    diff: FileName | None = None,
    reading: Reading | None = None,
) -> FileComparison:
    """Compare two EXR files pixel by pixel, matching channels by name.

    diff: where to write ours - reference under the same channel names, float32, and the uint32 channel
    `class.I` (codes in its provenance); not written when the files are not comparable.
    reading: how to interpret files of other programs.
    Raises FileMissing or UnreadableExr for an input, OutputError for diff, Unclear for a file that can be read in two
    ways, SceneError for an `ignore` that matches no channel or a diff that would overwrite an input.
    """
    reading, names = reading or Reading(), (str(ours), str(reference))
    files = [read_exr(ours), read_exr(reference)]
    if diff is not None and any(os.path.exists(diff) and os.path.samefile(diff, each) for each in (ours, reference)):
        raise SceneError(f"{diff}: expected another file for the difference: this is an image that is compared")
    check_maps(reading.maps, *(exr.channels for exr in files))
    converted, stated = list[Exr](), list[str]()
    for who, exr, other in zip(SIDES, files, files[::-1], strict=True):
        with error_prefix(who):
            found, steps = to_our_conventions(exr, reading, [scene_in(other)])
        converted.append(found)
        stated += [f"{who}: {step}" for step in steps]
    a, b = converted
    foreign = [i for i in (0, 1) if converted[i] is not files[i]]
    alone = sorted(a.channels.keys() ^ b.channels.keys()) if foreign else []
    stated += [f"not compared, since only one file has them: {', '.join(alone)}"] if alone else []
    result = compare_images(a, b, tolerances, names=names, stated=tuple(stated), left_out=alone, diff=diff)
    if result.exit_code != DIFFERENCES:
        return result
    more = (f"{SIDES[i]}: {hint}" for i in foreign for hint in hints(converted[i], converted[1 - i], reading))
    return result.model_copy(update={"hints": tuple(more)})


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
    about: dict[str, Any] = {"ours": names[0], "reference": names[1], "ignored": ignored, "stated": stated}
    left_out = {*ignored, *left_out}
    if reasons := tuple(incompatibilities(a, b, left_out, other_scene=tolerances.other_scene)):
        return FileComparison(**about, reasons=reasons)
    pair = ExrPair.of(a, b, [name for name in a.channels if name not in left_out])
    judged = [judge(pair, group, channels, tolerances) for group, channels in present_groups(pair)]
    results, *masks = zip(*judged, strict=True)
    differ, broken = (np.any(each, axis=0) for each in masks)
    if diff is not None:
        write_difference(diff, pair, differ, broken, *names)
    bad = int((differ | broken).sum())
    failed = bool(broken.any()) or bad > tolerances.max_pixels
    height, width = differ.shape
    return FileComparison(
        **about,
        width=width,
        height=height,
        hit_ours=int(pair.hit_ours.sum()),
        hit_reference=int(pair.hit_reference.sum()),
        hit_either=int(pair.hit_either.sum()),
        hit_channel=pair.mask_channel,
        differing_pixels=bad,
        allowed_pixels=tolerances.max_pixels,
        compared=len(pair.names),
        groups=results,
        exit_code=DIFFERENCES if failed else NOTHING_SELECTED if _is_empty(pair) else OK,
        scene=tuple(filter(None, (exr.provenance.get(SCENE) for exr in (a, b))))[:1],
        diff="" if diff is None else str(diff),
    )


def _is_empty(pair: ExrPair) -> bool:
    """Whether nothing was hit; without a mask channel, whether every number of both images is 0."""
    if pair.mask_channel:
        return not pair.hit_either.any()
    return not any(exr.channels[name].any() for exr in (pair.ours, pair.reference) for name in pair.names)


# ---- what is compared ----


def ignored_channels(a: Exr, b: Exr, patterns: Iterable[str]) -> tuple[str, ...]:
    """The channels that --ignore patterns name. Raises SceneError for a pattern that names none."""
    names = sorted(a.channels.keys() | b.channels.keys())
    found: set[str] = set()
    for pattern in patterns:
        matches = [n for n in names if n in LAYERS.get(pattern, ()) or fnmatch.fnmatchcase(n, pattern)]
        if not matches:
            hint = suggestion(pattern, [*LAYERS, *names])
            raise SceneError(f"--ignore {pattern}: neither file has such a channel{hint}; they have {', '.join(names)}")
        found.update(matches)
    return tuple(sorted(found))


def incompatibilities(a: Exr, b: Exr, left_out: set[str], *, other_scene: bool) -> Iterator[str]:
    """Why two images cannot be compared, a sentence each; none if they can."""
    if not other_scene and len({exr.provenance.get(SCENE_HASH) for exr in (a, b)} - {None}) > 1:
        yield f"the files are of different scenes, by their attributes ({SCENE_HASH}); --other-scene compares anyway"
    (x0, y0, x1, y1), (u0, v0, u1, v1) = a.data_window, b.data_window
    if (x1 - x0, y1 - y0) != (u1 - u0, v1 - v0):
        yield f"size: ours is {x1 - x0} x {y1 - y0}, the reference {u1 - u0} x {v1 - v0}"
    elif a.data_window != b.data_window:
        yield f"data window: ours shows pixels {a.data_window}, the reference {b.data_window}"
    ours, reference = a.channels.keys() - left_out, b.channels.keys() - left_out
    for mine, others, whose in ((ours, reference, "ours"), (reference, ours, "the reference")):
        for name in sorted(mine - others):
            yield f"channel {name} is in {whose} only{suggestion(name, sorted(others - mine))}"
    for name in sorted(ours & reference):
        kinds = a.channels[name].dtype, b.channels[name].dtype
        if (kinds[0] == np.uint32) != (kinds[1] == np.uint32):
            yield f"channel {name}: ours holds {kinds[0]}, the reference {kinds[1]}"
    if not ours & reference:
        yield "no channel in common: nothing could be compared"
    elif ours ^ reference:
        yield "to compare the rest: --ignore CHANNEL (or a pattern such as 'id.*')"


def present_groups(pair: ExrPair) -> list[tuple[str, tuple[str, ...]]]:
    """Hits, the groups that are present in the order of LAYERS, then every other channel by itself."""
    groups = {group: tuple(n for n in layer if n in pair.names) for group, layer in LAYERS.items()}
    groups |= {n: (n,) for n in pair.names if not any(n in layer for layer in LAYERS.values())}
    groups["hit"] = (pair.mask_channel,) if pair.mask_channel else ()
    return [(group, channels) for group, channels in groups.items() if channels]


# ---- each quantity against its bound ----


def judge(pair: ExrPair, group: str, names: tuple[str, ...], tol: Tolerances) -> tuple[GroupResult, Array, Array]:
    """Compare one quantity with its bound: hits in every pixel, all else where both images hit or both miss.

    Returns the result, (h, w) bool where the quantity differs, and (h, w) bool where a value should be finite and is
    not.
    """
    if group == "hit":
        masks = (mask[..., None].astype(np.float64) for mask in (pair.hit_ours, pair.hit_reference))
        a, b = pair.values(names) if names == LAYERS["hit"] else masks
        bound, text, where = np.zeros_like(b), "exact", np.ones_like(b, bool)
    else:
        (a, b), (bound, text), where = pair.values(names), bound_of(pair, group, names, tol), pair.same_mask[..., None]
    # Infinity is a valid value only as the depth of a ray that hits nothing.
    far_a, far_b = (
        (values == np.inf) & ~hit[..., None] & (group == "depth")
        for values, hit in ((a, pair.hit_ours), (b, pair.hit_reference))
    )
    broken = (~np.isfinite(a) & ~far_a) | (~np.isfinite(b) & ~far_b) | ((far_a != far_b) & where)
    with np.errstate(invalid="ignore"):  # inf - inf and NaN: both are in `broken`, or both images miss
        within = (np.abs(a - b) <= bound) | (far_a & far_b)
    wrong = ~within & ~broken & where  # "not within", so that a NaN can never pass as "not beyond"
    worst = _worst(pair, names, a, b, bound, (where & ~(far_a & far_b)) | broken)
    broken = broken.any(-1)
    differ = wrong.any(-1) & ~broken
    agree = pair.hit_ours & pair.hit_reference & ~differ & ~broken
    counts = {"agree": int(agree.sum()), "differ": int(differ.sum()), "non_finite": int(broken.sum())}
    return GroupResult(name=group, channels=names, bound=text, worst=worst, **counts), differ, broken


def _worst(pair: ExrPair, names: tuple[str, ...], a: Array, b: Array, bound: Array, eligible: Array) -> Worst | None:
    with np.errstate(all="ignore"):
        error = np.abs(a - b)
        ratio = np.where(error == 0.0, 0.0, error / bound)
    ratio = np.where(eligible, np.nan_to_num(ratio, nan=np.inf), 0.0)
    among = np.where(ratio == ratio.max(), np.nan_to_num(error, nan=np.inf), -1.0)  # where no error is allowed: largest
    at = y, x, c = np.unravel_index(int(among.argmax()), ratio.shape)
    if ratio[at] == 0.0:
        return None
    x0, y0 = pair.reference.data_window[:2]
    numbers = {"ours": a, "reference": b, "error": error, "bound": bound}
    return Worst(
        channel=names[c], x=x0 + int(x), y=y0 + int(y), **{name: float(values[at]) for name, values in numbers.items()}
    )


# ---- the difference image ----


def write_difference(path: FileName, pair: ExrPair, differ: Array, broken: Array, ours: str, reference: str) -> None:
    """Each channel's difference under its own name, float32, and `class.I`; ours, reference: what was read.

    Raises OutputError.
    """
    channels = {}
    for name in pair.names:
        a, b = (values[..., 0] for values in pair.values([name]))
        with np.errstate(invalid="ignore"):
            channels[name] = clipped_to_float32(np.where(a == b, 0.0, a - b))  # inf on both sides is no difference
    conditions = {NON_FINITE: broken, HIT_MISS: ~pair.same_mask, DIFFER: differ, AGREE: pair.hit_either}
    channels["class.I"] = np.select([*conditions.values()], [*conditions], MISS).astype(np.uint32)
    about = {"kind": "ours minus reference", "class": CLASSES, "ours": ours, "reference": reference}
    data, display = pair.reference.data_window, pair.reference.display_window
    write_exr(path, channels, about, data_window=data, display_window=display)

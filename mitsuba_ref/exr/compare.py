"""Compare two EXR files pixel by pixel; NaN, renamed channels, another window or a missed pixel never pass.

An EXR holds no primitives, so the bounds of `validate` cannot be derived here. Where the reference carries
`position`, `depth` and `normal` and its provenance names the camera, they give the condition of each pixel
(how far numbers reach, how grazing the ray is, how fast the surface turns) and with it a first-order bound;
elsewhere plain tolerances apply, and the result says which it was.
"""

import os
import shlex
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from caster.exits import DIFFERENCES, NOTHING_SELECTED, OK
from caster.exr import read_exr
from caster.wording import SceneError
from mitsuba_ref.exr.difference_image import write_difference
from mitsuba_ref.exr.differences import Judged, judge, judge_hits, present_groups
from mitsuba_ref.exr.foreign import Reading, translated
from mitsuba_ref.exr.layers import LAYERS
from mitsuba_ref.exr.messages import messages_of
from mitsuba_ref.exr.pairs import Pair, channels_left_out, obstacles, size_of
from mitsuba_ref.exr.result import FileComparison, GroupResult, Worst
from mitsuba_ref.exr.tolerances import COLOR_RTOL, DEPTH_RTOL, NORMAL_ATOL, TYPICAL_ATOL, Tolerances

__all__ = [
    "COLOR_RTOL",
    "DEPTH_RTOL",
    "LAYERS",
    "NORMAL_ATOL",
    "TYPICAL_ATOL",
    "FileComparison",
    "GroupResult",
    "Reading",
    "Tolerances",
    "Worst",
    "compare_exr",
]

Name = str | os.PathLike[str]


def compare_exr(
    ours: Name,
    reference: Name,
    tolerances: Tolerances | None = None,
    *,
    diff: Name | None = None,
    reading: Reading | None = None,
) -> FileComparison:
    """Judge every pixel of two EXR files, by channel name.

    diff: where to write ours - reference under the same channel names, float32, and the uint32 channel
    `class.I` (codes in its provenance); not written when the files are not comparable.
    reading: how files of other programs are to be read, where their numbers do not tell.
    Raises FileMissing or UnreadableExr for an input, OutputError for diff, SceneError for an `ignore` that
    names nothing or a diff that would overwrite an input.
    """
    tolerances = tolerances or Tolerances()
    a, b = read_exr(ours), read_exr(reference)
    if diff is not None and _same_file(diff, (ours, reference)):
        raise SceneError(f"{diff}: the difference would overwrite an image it compares; give another name")
    a, b, stated, alone, unclear = translated(a, b, reading or Reading())
    ignored = channels_left_out(a, b, tolerances.ignore)
    blank = FileComparison(str(ours), str(reference), ignored=ignored, stated=stated)
    left_out = (*ignored, *alone)
    reasons = unclear or obstacles(a, b, left_out, other_scene=tolerances.other_scene)
    if reasons:
        return _refused(blank, reasons)
    pair = Pair.of(a, b, [name for name in a.channels if name not in left_out])
    judged = _judged(pair, tolerances)
    if diff is not None:
        write_difference(diff, pair, judged, blank.ours, blank.reference)
    counted = _counted(blank, pair, judged, tolerances)
    return replace(counted, messages=tuple(messages_of(counted, pair, diff)))


def _same_file(path: Name, others: Iterable[Name]) -> bool:
    return os.path.exists(path) and any(os.path.samefile(path, other) for other in others)


def _refused(blank: FileComparison, reasons: Iterable[str]) -> FileComparison:
    look = f"next:   caster info {shlex.quote(blank.ours)}; caster info {shlex.quote(blank.reference)}"
    return replace(blank, messages=("NOT COMPARABLE", *(f"      {text}" for text in (*reasons, look))))


def _judged(pair: Pair, tolerances: Tolerances) -> list[Judged]:
    hits = [judge_hits(pair)] if pair.mask_channel else []
    groups = present_groups(pair.names)
    return hits + [judge(pair, group, names, tolerances) for group, names in groups]


def _is_empty(pair: Pair) -> bool:
    """Nothing was hit; or, where no channel tells, every number of both images is 0."""
    if pair.mask_channel:
        return not (pair.hit_ours | pair.hit_reference).any()
    return not any(exr.channels[name].any() for exr in (pair.ours, pair.reference) for name in pair.names)


def _counted(
    blank: FileComparison, pair: Pair, judged: list[Judged], tolerances: Tolerances
) -> FileComparison:
    broken = np.any([j.broken for j in judged], axis=0)
    bad = int((np.any([j.differ for j in judged], axis=0) | broken).sum())
    failed = bool(broken.any()) or bad > tolerances.max_pixels
    masks = pair.hit_ours, pair.hit_reference, pair.hit_ours | pair.hit_reference
    hits = [int(mask.sum()) for mask in masks] if pair.mask_channel else [None] * 3
    empty = not tolerances.allow_empty and _is_empty(pair)
    width, height = size_of(pair.reference)
    return replace(
        blank,
        width=width,
        height=height,
        hit_ours=hits[0],
        hit_reference=hits[1],
        hit_either=hits[2],
        differing_pixels=bad,
        allowed_pixels=tolerances.max_pixels,
        groups=tuple(j.result for j in judged),
        exit_code=DIFFERENCES if failed else NOTHING_SELECTED if empty else OK,
    )

"""Comparison of two EXR files pixel by pixel; NaN, renamed channels, another window or a missed pixel never pass.

An EXR holds no primitives, so the bounds of `validate` cannot be derived here. Where the reference carries `position`,
`depth` and `normal` and its provenance names the camera, they give the conditioning of each pixel (magnitude of the
numbers, angle of incidence, curvature) and with it a first-order bound; elsewhere plain tolerances apply. The result
states which it was.
"""

import os
import shlex
from collections.abc import Iterable

import numpy as np

from caster.description.errors import SceneError
from caster.image.exr import read_exr, write_exr
from caster.system.process import DIFFERENCES, NOTHING_SELECTED, OK
from mitsuba_ref.error_model.tolerances import Tolerances
from mitsuba_ref.exr_compare.comparison_result import FileComparison, failing_groups, result_messages
from mitsuba_ref.exr_compare.differences import Judged, judge, judge_hits, present_groups
from mitsuba_ref.exr_compare.exr_pair import (
    SCENE_HASH,
    Array,
    ExrPair,
    ignored_channels,
    incompatibilities,
    size_of,
)
from mitsuba_ref.exr_compare.foreign_files import Reading, to_our_conventions

__all__ = ["FileComparison", "Reading", "Tolerances", "compare_exr"]

FileName = str | os.PathLike[str]
LARGEST_FLOAT32 = float(np.finfo(np.float32).max)  # what an EXR channel holds
SCENE = "caster/scene"  # provenance: the scene's path

MISS, AGREE, DIFFER, HIT_MISS, NON_FINITE = range(5)
CLASSES = "0 missed by both, 1 hit by both and agrees, 2 differs, 3 hit in one image only, 4 not finite"


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
    reading: how to interpret files of other programs, where their numbers do not decide.
    Raises FileMissing or UnreadableExr for an input, OutputError for diff, SceneError for an `ignore` that
    names nothing or a diff that would overwrite an input.
    """
    tolerances = tolerances or Tolerances()
    a, b = read_exr(ours), read_exr(reference)
    if diff is not None and _same_file(diff, (ours, reference)):
        raise SceneError(f"{diff}: the difference would overwrite an image it compares; give another name")
    a, b, stated, alone, unclear = to_our_conventions(a, b, reading or Reading())
    ignored = ignored_channels(a, b, tolerances.ignore)
    blank = FileComparison(ours=str(ours), reference=str(reference), ignored=ignored, stated=stated)
    left_out = (*ignored, *alone)
    reasons = unclear or incompatibilities(a, b, left_out, other_scene=tolerances.other_scene)
    if reasons:
        return _not_comparable(blank, reasons)
    pair = ExrPair.of(a, b, [name for name in a.channels if name not in left_out])
    judged = _judged(pair, tolerances)
    if diff is not None:
        write_difference(diff, pair, judged, blank.ours, blank.reference)
    counted = _counted(blank, pair, judged, tolerances)
    notes = [*_half_notes(pair), *_scene_notes(pair)]
    messages = result_messages(counted, len(pair.names), _next_steps(counted, pair, diff), notes)
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


def _counted(
    blank: FileComparison, pair: ExrPair, judged: list[Judged], tolerances: Tolerances
) -> FileComparison:
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
    return [
        *([look] if diff is not None else []),
        replay if scene and scene.isprintable() else info,
        note,
    ]


def _half_notes(pair: ExrPair) -> list[str]:
    stored = (("ours", pair.ours), ("the reference", pair.reference))
    half = [who for who, exr in stored if any(exr.channels[n].dtype == np.float16 for n in pair.names)]
    return [
        f"note: {who} holds halves, 11 bits a number, and its bounds are a half's; float32 would show more"
        for who in half
    ]


def _scene_notes(pair: ExrPair) -> list[str]:
    hashes = {exr.provenance.get(SCENE_HASH) for exr in (pair.ours, pair.reference)} - {None}
    note = f"note: the files are of different scenes, by their attributes ({SCENE_HASH})"
    return [note] if len(hashes) > 1 else []


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

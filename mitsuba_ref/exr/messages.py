"""What a comparison says last: pass or fail, how far, where to look, and the next command."""

import math
import os
import shlex

import numpy as np

from mitsuba_ref.exr.difference_image import CLASSES
from mitsuba_ref.exr.pairs import SCENE_HASH, Pair
from mitsuba_ref.exr.result import FileComparison, GroupResult

SCENE = "caster/scene"  # provenance: the scene's path


def messages_of(result: FileComparison, pair: Pair, diff: str | os.PathLike[str] | None) -> list[str]:
    """The lines below the table."""
    notes = [*_half_notes(pair), *_scene_notes(pair)]
    if result.exit_code == 5:
        return [
            "EMPTY  neither image hits anything, so nothing was compared",
            "      if that is what the scene shows: --allow-empty",
            *notes,
        ]
    if result.exit_code == 1:
        bad = [g for g in result.groups if g.differ or g.non_finite]
        return [*(_failure(g, result) for g in bad), *_where_to_look(bad[0], result, pair, diff), *notes]
    if result.differing_pixels:
        return [f"PASS  {result.differing_pixels} pixels differ, {result.allowed_pixels} may", *notes]
    ratio, group = max(((g.worst.ratio, g.name) for g in result.groups if g.worst), default=(0.0, ""))
    nearest = f", worst {ratio:.2g}x its bound ({group})" if group else ""
    return [f"PASS  {_hit_pixels(result)} agree in {len(pair.names)} channels{nearest}", *notes]


def _hit_pixels(result: FileComparison) -> str:
    if result.hit_either is None:
        return f"{result.width * result.height} pixels"
    return f"{result.hit_either} hit pixels"


def percent(count: int, total: int) -> str:
    """Two digits, but 100 only for all."""
    share = 100.0 * count / total
    return f"{share:.2g} %" if share < 99.0 else f"{share:.4g} %"


def _failure(group: GroupResult, result: FileComparison) -> str:
    total = result.width * result.height if result.hit_either is None else result.hit_either
    share = f" ({percent(group.differ, total)})" if total else ""
    what = "are hit in one image only or differ in A" if group.name == "hit" else "beyond their bound"
    found = [f"{group.differ} of {_hit_pixels(result)}{share} {what}"] if group.differ else []
    found += [f"{group.non_finite} pixels not finite"] if group.non_finite else []
    text = f"FAIL  {group.name}: {', '.join(found)}"
    if group.worst is None:
        return text
    w = group.worst
    far = f"worst {w.ratio:.3g}x" if math.isfinite(w.ratio) else "first"
    return f"{text}, {far} at ({w.x}, {w.y}) in {w.channel}: ours {w.ours:.9g}, reference {w.reference:.9g}"


def _where_to_look(
    group: GroupResult, result: FileComparison, pair: Pair, diff: str | os.PathLike[str] | None
) -> list[str]:
    at = f"{group.worst.x} {group.worst.y}" if group.worst else "0 0"
    scene = next(filter(None, (exr.provenance.get(SCENE) for exr in (pair.ours, pair.reference))), "")
    look = f"      look:   {diff}, channel class.I ({CLASSES})"
    replay = f"      replay: mitsuba-ref probe {shlex.quote(scene)} {at}"
    info = f"      next:   caster info {shlex.quote(result.ours)}"
    way_out = "      note:   rounding decides edges and shadow borders; validate tells, --max-pixels N lets them pass"
    return [*([look] if diff is not None else []), replay if scene and scene.isprintable() else info, way_out]


def _half_notes(pair: Pair) -> list[str]:
    stored = (("ours", pair.ours), ("the reference", pair.reference))
    half = [who for who, exr in stored if any(exr.channels[n].dtype == np.float16 for n in pair.names)]
    return [
        f"note: {who} holds halves, 11 bits a number, and its bounds are a half's; float32 would show more"
        for who in half
    ]


def _scene_notes(pair: Pair) -> list[str]:
    hashes = {exr.provenance.get(SCENE_HASH) for exr in (pair.ours, pair.reference)} - {None}
    note = f"note: the files say that they show different scenes ({SCENE_HASH})"
    return [note] if len(hashes) > 1 else []

"""Result of a comparison of two EXR files: a model with one JSON schema, and its text for a terminal."""

import math
import shlex
from collections.abc import Iterator

from pydantic import BaseModel, ConfigDict, computed_field

from mitsuba_ref.error_model.tolerances import K
from mitsuba_ref.judge.verdict import JsonFloat
from mitsuba_ref.report.results import aligned, percent

LEGEND = f"u = 2^-24, K = {K:g}, S = |o| + t + |p| and cos = |n.d| of each pixel of the reference"
TITLES = ("quantity", "agree", "differ", "not finite", "worst", "at", "bound")


class Worst(BaseModel):
    """The pixel of a group with the largest error over bound, in film coordinates."""

    model_config = ConfigDict(frozen=True)

    channel: str
    x: int
    y: int
    ours: JsonFloat
    reference: JsonFloat
    error: JsonFloat
    bound: JsonFloat

    @computed_field  # type: ignore[prop-decorator] # pydantic's way
    @property
    def ratio(self) -> JsonFloat:
        """error / bound; 0 where equal, inf where the bound is 0 or a value is not finite."""
        if self.error == 0.0:
            return 0.0
        return self.error / self.bound if self.bound > 0.0 and math.isfinite(self.error) else math.inf


class GroupResult(BaseModel):
    """One quantity. agree counts pixels hit in both images; differ and non_finite all (misses hold values).

    Pixels that only one image hits count under `hit` alone, unless a value of theirs is not finite.
    """

    model_config = ConfigDict(frozen=True)

    name: str
    channels: tuple[str, ...]
    bound: str
    agree: int
    differ: int
    non_finite: int
    worst: Worst | None


class FileComparison(BaseModel):
    """exit_code: 0 equal within the bounds, 1 differences, 3 not comparable, 5 nothing hit in either image.

    hit_*: pixel counts; hit_channel: the channel that shows the hits, "" if there is none and every pixel counts.
    differing_pixels counts a pixel once, however many groups differ in it. stated: conventions that were applied to
    files of other programs.
    """

    model_config = ConfigDict(frozen=True)

    ours: str
    reference: str
    width: int = 0
    height: int = 0
    hit_ours: int = 0
    hit_reference: int = 0
    hit_either: int = 0
    hit_channel: str = ""
    differing_pixels: int = 0
    allowed_pixels: int = 0
    groups: tuple[GroupResult, ...] = ()
    ignored: tuple[str, ...] = ()
    exit_code: int = 3
    messages: tuple[str, ...] = ()
    stated: tuple[str, ...] = ()

    @computed_field  # type: ignore[prop-decorator] # pydantic's way
    @property
    def ok(self) -> bool:
        """Whether the files are equal within the bounds."""
        return self.exit_code == 0

    @computed_field  # type: ignore[prop-decorator] # pydantic's way
    @property
    def differing_percent(self) -> float | None:
        """Of the pixels hit in either image; None if there are none."""
        return 100.0 * self.differing_pixels / self.hit_either if self.hit_either else None

    def format_table(self) -> str:
        """What `mitsuba-ref compare` prints: one line a group, then the verdict and the next command."""
        lines = [f"ours       {self.ours}", f"reference  {self.reference}"]
        lines += [f"reading    {line}" for line in self.stated]
        if self.groups:
            hits = f"hit: {self.hit_ours} in ours, {self.hit_reference} in the reference, {self.hit_either} in either"
            hits = hits if self.hit_channel else "hits unknown (no channel A, id.shape, id.prim or depth.Z)"
            lines += [f"{self.width} x {self.height} pixels, {hits}", ""]
            rows = [TITLES, *map(_row, self.groups)]
            table = aligned([row[:-1] for row in rows], left=1)
            lines += [f"{line}  {row[-1]}" for line, row in zip(table, rows, strict=True)]
            lines += [LEGEND, ""] if any("K u S" in group.bound for group in self.groups) else [""]
        if self.ignored:
            lines.append(f"not compared, by --ignore: {', '.join(self.ignored)}")
        return "\n".join([*lines, *self.messages])


def _row(group: GroupResult) -> tuple[str, ...]:
    worst = group.worst
    ratio, at = (f"{worst.ratio:.2g}x", f"({worst.x}, {worst.y})") if worst else ("0x", "-")
    return group.name, str(group.agree), str(group.differ), str(group.non_finite), ratio, at, group.bound


def result_messages(result: FileComparison, channels: int, scene: str, look: str) -> Iterator[str]:
    """The lines below the table: pass or fail, how far, where to look.

    channels: how many were compared; scene: path of the scene's file, if known; look: the difference image, if written.
    """
    pixels = f"{result.hit_either} {'hit ' if result.hit_channel else ''}pixels"
    if result.exit_code == 5:
        yield "EMPTY  neither image hits anything, so nothing was compared"
    elif result.exit_code == 1:
        failing = [group for group in result.groups if group.differ or group.non_finite]
        yield from (_failure(group, result.hit_either, pixels) for group in failing)
        if look:
            yield f"      look:   {look}"
        worst = failing[0].worst
        at = f"{worst.x} {worst.y}" if worst else "0 0"
        replay = f"replay: mitsuba-ref probe {shlex.quote(scene)} {at}"
        info = f"next:   caster info {shlex.quote(result.ours)}"
        yield f"      {replay if scene and scene.isprintable() else info}"
        yield "      note:   rounding decides edges and shadow borders; see validate; --max-pixels N allows them"
    elif result.differing_pixels:
        yield f"PASS  {result.differing_pixels} pixels differ, {result.allowed_pixels} may"
    else:
        ratio, name = max(((g.worst.ratio, g.name) for g in result.groups if g.worst), default=(0.0, ""))
        nearest = f", worst {ratio:.2g}x its bound ({name})" if name else ""
        yield f"PASS  {pixels} agree in {channels} channels{nearest}"


def _failure(group: GroupResult, total: int, pixels: str) -> str:
    share = f" ({percent(group.differ, total)})" if total else ""
    what = "are hit in one image only or differ in A" if group.name == "hit" else "beyond their bound"
    found = [f"{group.differ} of {pixels}{share} {what}"] if group.differ else []
    found += [f"{group.non_finite} pixels not finite"] if group.non_finite else []
    text = f"FAIL  {group.name}: {', '.join(found)}"
    if group.worst is None:
        return text
    w = group.worst
    far = f"worst {w.ratio:.3g}x" if math.isfinite(w.ratio) else "first"
    return f"{text}, {far} at ({w.x}, {w.y}) in {w.channel}: ours {w.ours:.9g}, reference {w.reference:.9g}"

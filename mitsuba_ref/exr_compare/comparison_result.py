"""Result of a comparison of two EXR files: a model with one JSON schema, and its text for a terminal."""

import math
import shlex
from collections.abc import Iterator

from pydantic import BaseModel, computed_field

from caster.system.process import DIFFERENCES, NOT_COMPARABLE, NOTHING_SELECTED, OK
from mitsuba_ref.error_model.tolerances import K
from mitsuba_ref.judge.verdict import JsonFloat
from mitsuba_ref.report.output import aligned, percent

LEGEND = f"; where u = 2^-24, K = {K:g}, S = |o| + t + |p| and cos = |n.d| of each pixel of the reference"
LEGEND_OF_SLOPE = ", slope = its change per scene unit there"


class Worst(BaseModel, frozen=True):
    """The pixel of a group with the largest error over bound, in film coordinates."""

    channel: str
    x: int
    y: int
    ours: JsonFloat
    reference: JsonFloat
    error: JsonFloat
    bound: JsonFloat
    ratio: JsonFloat  # error / bound; inf where the bound is 0 or a value is not finite


class GroupResult(BaseModel, frozen=True):
    """One quantity. agree counts pixels hit in both images; differ and non_finite all (misses hold values).

    Pixels that only one image hits count under `hit` alone, unless a value of theirs is not finite.
    """

    name: str
    channels: tuple[str, ...]
    bound: str
    agree: int
    differ: int
    non_finite: int
    worst: Worst | None


class FileComparison(BaseModel, frozen=True):
    """exit_code: 0 equal within the bounds, 1 differences, 3 not comparable, 4 missing, 5 nothing hit in either image.

    ours, reference: file names, or names of what was compared. hit_*: pixel counts; hit_channel: the channel that shows
    the hits, "" if there is none and every pixel counts. differing_pixels counts a pixel once, however many groups
    differ in it. compared: how many channels were. stated: conventions that were applied to files of other programs.
    reasons: why nothing was compared. scene: its file, if known. html: the folder of a
    page, if written. measures: (what, value), for information.
    """

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
    compared: int = 0
    groups: tuple[GroupResult, ...] = ()
    ignored: tuple[str, ...] = ()
    exit_code: int = NOT_COMPARABLE
    reasons: tuple[str, ...] = ()
    stated: tuple[str, ...] = ()
    hints: tuple[str, ...] = ()
    scene: str = ""
    html: str = ""
    measures: tuple[tuple[str, str], ...] = ()

    def __repr__(self) -> str:
        return f"<FileComparison: {'pass' if self.ok else 'differences' if self.width else 'not comparable'}>"

    @computed_field  # type: ignore[prop-decorator] # pydantic's way
    @property
    def ok(self) -> bool:
        """Whether the files are equal within the bounds."""
        return self.exit_code == OK

    @computed_field  # type: ignore[prop-decorator] # pydantic's way
    @property
    def messages(self) -> tuple[str, ...]:
        """The lines below the table: pass or fail, how far, where to look."""
        mark = {OK: "PASS  ", DIFFERENCES: "FAIL  ", NOTHING_SELECTED: "EMPTY  "}.get(self.exit_code, "      ")
        found = [mark + line for line in self.findings()]
        info = f"      next:   caster info {shlex.quote(self.ours)}"
        if self.exit_code == NOT_COMPARABLE:
            return "NOT COMPARABLE", *found, f"{info}; caster info {shlex.quote(self.reference)}"
        if self.exit_code == DIFFERENCES and self.groups:
            found += [f"      {self.replay}" if self.replay else info]
            found.append(
                "      note:   rounding decides edges and shadow borders; see validate; --max-pixels N allows them"
            )
        return *found, *(f"hint:   {hint}" for hint in self.hints)

    @property
    def replay(self) -> str:
        """The command about the first pixel that differs; "" if the scene's file is not known."""
        failing = self._failing()
        if not (failing and self.scene.isprintable() and self.scene):
            return ""
        worst = failing[0].worst
        assert worst is not None  # of a group that fails
        return "replay: " + shlex.join(["mitsuba-ref", "probe", self.scene, str(worst.x), str(worst.y)])

    def findings(self) -> Iterator[str]:
        """What was found, without the words PASS and FAIL."""
        pixels = f"{self.hit_either} {'hit ' if self.hit_channel else ''}pixels"
        if self.exit_code == NOTHING_SELECTED:
            yield "neither image hits anything, so nothing was compared"
        elif self.exit_code == DIFFERENCES:
            yield from (_failure(group, self.hit_either, pixels) for group in self._failing())
        elif self.differing_pixels:
            yield f"{self.differing_pixels} pixels differ, {self.allowed_pixels} may"
        elif self.ok:
            ratio, name = max(((g.worst.ratio, g.name) for g in self.groups if g.worst), default=(0.0, ""))
            nearest = f", worst {ratio:.2g}x its bound ({name})" if name else ""
            yield f"{pixels} agree in {self.compared} channels{nearest}"
        yield from self.reasons

    def __str__(self) -> str:
        """What `mitsuba-ref compare` prints: one line a group, then the verdict and the next command."""
        lines = [f"ours:      {self.ours}", f"reference: {self.reference}"]
        lines += [f"reading:   {line}" for line in self.stated]
        if self.groups:
            hits = f"hit: {self.hit_ours} in ours, {self.hit_reference} in the reference, {self.hit_either} in either"
            hits = hits if self.hit_channel else "hits unknown (no channel A, id.shape, id.prim or depth.Z)"
            lines += [f"{self.width} x {self.height} pixels, {hits}", ""]
            bounds = "; ".join(f"{group.name} {group.bound}" for group in self.groups)
            legend = (LEGEND if "K*u*S" in bounds else "") + (LEGEND_OF_SLOPE if "slope" in bounds else "")
            rows = [("quantity", "agree", "differ", "not finite", "worst", "at")]
            for group in self.groups:
                worst = group.worst
                ratio, at = (f"{worst.ratio:.2g}x", f"({worst.x}, {worst.y})") if worst else ("equal", "-")
                rows.append((group.name, str(group.agree), str(group.differ), str(group.non_finite), ratio, at))
            lines += [*aligned(rows, left=1), f"bounds:    {bounds}{legend}", ""]
        if self.ignored:
            lines.append(f"not compared, by --ignore: {', '.join(self.ignored)}")
        lines += self.messages
        width = max((len(what) for what, _ in self.measures), default=0)
        lines += ["", "for information:"] if self.measures else []
        lines += [f"  {what:<{width}}  {value}" for what, value in self.measures]
        return "\n".join(lines)

    def _failing(self) -> list[GroupResult]:
        return [group for group in self.groups if group.differ or group.non_finite]


def _failure(group: GroupResult, total: int, pixels: str) -> str:
    share = f" ({percent(group.differ, total)})" if total else ""
    what = "are hit in one image only or differ in A" if group.name == "hit" else "beyond their bound"
    found = [f"{group.differ} of {pixels}{share} {what}"] if group.differ else []
    found += [f"{group.non_finite} pixels not finite"] if group.non_finite else []
    w = group.worst
    assert w is not None  # of a group that fails
    far = f"worst {w.ratio:.3g}x" if math.isfinite(w.ratio) else "first"
    at = f"{far} at ({w.x}, {w.y}) in {w.channel}: ours {w.ours:.9g}, reference {w.reference:.9g}"
    return f"{group.name}: {', '.join(found)}, {at}"

"""What came out of a comparison of two EXR files, as text and for JSON."""

import math
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.error_model.exr_tolerances import Tolerances
from mitsuba_ref.error_model.intersections import K
from mitsuba_ref.exr_compare.channel_bounds import bound_of
from mitsuba_ref.exr_compare.exr_layers import LAYERS, Array
from mitsuba_ref.exr_compare.exr_pair import ExrPair

LEGEND = f"u = 2^-24, K = {K:g}, S = |o| + t + |p| and cos = |n.d| of each pixel of the reference"


@dataclass(frozen=True)
class Worst:
    """The pixel of a group that is farthest beyond (or nearest to) its bound, in film coordinates."""

    channel: str
    x: int
    y: int
    ours: float
    reference: float
    error: float
    bound: float

    @property
    def ratio(self) -> float:
        """error / bound; 0 where equal, inf where the bound is 0 or a value is not finite."""
        if self.error == 0.0:
            return 0.0
        return self.error / self.bound if self.bound > 0.0 and math.isfinite(self.error) else math.inf


@dataclass(frozen=True)
class GroupResult:
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


@dataclass(frozen=True)
class FileComparison:
    """exit_code: 0 equal within the bounds, 1 differences, 3 not comparable, 5 nothing hit in either image.

    hit_*: pixel counts, None if no channel tells. differing_pixels counts a pixel once, however many groups
    differ in it.
    """

    ours: str
    reference: str
    width: int = 0
    height: int = 0
    hit_ours: int | None = None
    hit_reference: int | None = None
    hit_either: int | None = None
    differing_pixels: int = 0
    allowed_pixels: int = 0
    groups: tuple[GroupResult, ...] = ()
    ignored: tuple[str, ...] = ()
    exit_code: int = 3
    messages: tuple[str, ...] = ()
    stated: tuple[str, ...] = ()  # what was taken for what in files of other programs

    @property
    def ok(self) -> bool:
        return self.exit_code == 0

    @property
    def differing_percent(self) -> float | None:
        """Of the pixels hit in either image; None if there are none or no channel tells."""
        return 100.0 * self.differing_pixels / self.hit_either if self.hit_either else None

    def to_dict(self) -> dict[str, Any]:
        """For JSON: a number that is not finite becomes the string "nan", "inf" or "-inf"."""
        groups = [
            asdict(g) | {"worst": g.worst and asdict(g.worst) | {"ratio": g.worst.ratio}} for g in self.groups
        ]
        derived = {"groups": groups, "ok": self.ok, "differing_percent": self.differing_percent}
        plain: dict[str, Any] = _json_safe(asdict(self) | derived)
        return plain

    def format_table(self) -> str:
        """What `mitsuba-ref compare` prints: one line a group, then the verdict and where to look."""
        lines = [f"ours       {self.ours}", f"reference  {self.reference}"]
        lines += [f"reading    {line}" for line in self.stated]
        if self.groups:
            lines += [_hit_line(self), "", *_rows(self.groups)]
            lines += [LEGEND, ""] if any("K u S" in g.bound for g in self.groups) else [""]
        if self.ignored:
            lines.append(f"not compared, as asked: {', '.join(self.ignored)}")
        return "\n".join([*lines, *self.messages])


def _hit_line(result: FileComparison) -> str:
    size = f"{result.width} x {result.height} pixels"
    if result.hit_either is None:
        return f"{size}, hits unknown (no channel A, id.shape, id.prim or depth.Z)"
    by_file = f"{result.hit_ours} in ours, {result.hit_reference} in the reference"
    return f"{size}, hit: {by_file}, {result.hit_either} in either"


def _rows(groups: tuple[GroupResult, ...]) -> list[str]:
    table = [("quantity", "agree", "differ", "not finite", "worst", "at", "bound")]
    for g in groups:
        worst = (f"{g.worst.ratio:.2g}x", f"({g.worst.x}, {g.worst.y})") if g.worst else ("0x", "-")
        table.append((g.name, str(g.agree), str(g.differ), str(g.non_finite), *worst, g.bound))
    widths = [max(len(row[i]) for row in table) for i in range(6)]
    numbers = [[row[i].rjust(widths[i]) for i in range(1, 6)] for row in table]
    return [
        "  ".join([row[0].ljust(widths[0]), *cells, row[6]])
        for row, cells in zip(table, numbers, strict=True)
    ]


def _json_safe(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _json_safe(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_json_safe(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value


# Where two images differ: each quantity judged pixel by pixel.


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


def judge_hits(pair: ExrPair) -> Judged:
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
    return Judged(GroupResult(group, names, text, *counts, worst), differing, unusable)


def _counts(pair: ExrPair, differ: Array, broken: Array) -> tuple[int, int, int]:
    agree = pair.hit_ours & pair.hit_reference & ~differ & ~broken
    return int(agree.sum()), int(differ.sum()), int(broken.sum())


def _depth_of_a_miss(group: str, values: Array, hit: Array) -> Array:
    """The only infinity that means something: the depth of a ray that hits nothing."""
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
    numbers = (float(values[y, x, c]) for values in (a, b, error, bound))
    return Worst(names[c], x0 + x, y0 + y, *numbers)

"""Compare two EXR files pixel by pixel; NaN, renamed channels, another window or a missed pixel never pass.

An EXR holds no primitives, so the bounds of `validate` cannot be derived here. Where the reference carries
`position`, `depth` and `normal` and its provenance names the camera, they give the condition of each pixel
(how far numbers reach, how grazing the ray is, how fast the surface turns) and with it a first-order bound;
elsewhere plain tolerances apply, and the result says which it was.
"""

from __future__ import annotations

import fnmatch
import json
import math
import os
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from caster.exr import Exr, read_exr, write_exr
from caster.fields import SceneError, suggestion
from caster.info import hit_mask

Array = np.ndarray

U = 2.0**-24
"""The most one rounding to float32 moves a number, relative to it. Each file rounded each value once."""

K = 4.0
"""Roundings allowed on a first-order condition number. Mitsuba 3.9.1 was seen to need 2.8, mostly < 1.3."""

DEPTH_RTOL = K * U * 3
"""Of depth, where no condition is known: S / t = 3 (S = |o| + t + |p|) when ray origin and hit lie within one
depth of the world's origin, seen head on. Farther away or grazing needs the condition, or --depth-rtol."""

NORMAL_ATOL = K * U * (8 + 1)
"""Of a flat normal: K u (|Q|/|N| + 1), Q the permanent of the edges' cross product N. |Q|/|N| is at most
2 / sin(corner), below 8 for corners from 15 to 165 degrees; a thinner sliver needs --normal-atol."""

COLOR_RTOL = 16 * U
"""Of a colour: a Lambert term is at most 16 rounded operations (difference, square, root, dot, products)."""

TYPICAL_ATOL = K * U
"""Of a colour or uv, times the reference's typical value: cos(n, light) near 0 and the barycentric sum lose
digits against their full size, not against their result. Typical is the median of what is not 0: one
highlight, however bright, must not loosen the rest."""

DERIVED = "K u S / cos"
LEGEND = f"u = 2^-24, K = {K:g}, S = |o| + t + |p| and cos = |n.d| of each pixel of the reference"

# Provenance that is read here: the scene's path, its canonical text, the hash of that.
SCENE, SCENE_JSON, SCENE_HASH = "caster/scene", "caster/scene_json", "caster/scene_sha256"

UNRESOLVABLE = 0.5
"""A first-order error of half the value or more says nothing any more: the plain bound holds there."""

LAYERS: Mapping[str, tuple[str, ...]] = {
    "hit": ("A",),
    "depth": ("depth.Z",),
    "normal": ("normal.X", "normal.Y", "normal.Z"),
    "shading_normal": ("shading_normal.X", "shading_normal.Y", "shading_normal.Z"),
    "position": ("position.X", "position.Y", "position.Z"),
    "uv": ("uv.U", "uv.V"),
    "diffuse": ("R", "G", "B"),
    "albedo": ("albedo.R", "albedo.G", "albedo.B"),
    "shape_id": ("id.shape",),
    "prim_id": ("id.prim",),
}
"""Group -> channels. Any other channel is a group of its own, judged like a colour, or exactly if uint."""

MISS, AGREE, DIFFER, HIT_MISS, NON_FINITE = range(5)
CLASSES = "0 missed by both, 1 hit by both and agrees, 2 differs, 3 hit in one image only, 4 not finite"


@dataclass(frozen=True)
class Tolerances:
    """What may differ. None: the derived bound; a number replaces it: |error| <= rtol |reference| + atol.

    depth_rtol also holds for positions; color_* for every channel that is not geometry.
    max_pixels: how many pixels may differ (never by NaN or inf). ignore: groups or channel patterns left out.
    allow_empty: two images that hit nothing pass.
    """

    depth_rtol: float | None = None
    normal_atol: float | None = None
    uv_atol: float | None = None
    color_rtol: float | None = None
    color_atol: float | None = None
    max_pixels: int = 0
    ignore: tuple[str, ...] = ()
    allow_empty: bool = False

    def __post_init__(self) -> None:
        for name in ("depth_rtol", "normal_atol", "uv_atol", "color_rtol", "color_atol", "max_pixels"):
            value = getattr(self, name)
            if value is not None and not 0 <= value < math.inf:
                raise SceneError(f"--{name.replace('_', '-')}: expected a number >= 0, got {value}")


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
        if self.groups:
            lines += [_hit_line(self), "", *_rows(self.groups)]
            lines += [LEGEND, ""] if any("K u S" in g.bound for g in self.groups) else [""]
        if self.ignored:
            lines.append(f"not compared, as asked: {', '.join(self.ignored)}")
        return "\n".join([*lines, *self.messages])


def compare_exr(
    ours: str | os.PathLike[str],
    reference: str | os.PathLike[str],
    tolerances: Tolerances | None = None,
    *,
    diff: str | os.PathLike[str] | None = None,
) -> FileComparison:
    """Judge every pixel of two EXR files, by channel name.

    diff: where to write ours - reference under the same channel names, float32, and the uint32 channel
    `class.I` (codes in its provenance); not written when the files are not comparable.
    Raises FileMissing or UnreadableExr for an input, OutputError for diff, SceneError for an `ignore` that
    names nothing or a diff that would overwrite an input.
    """
    tolerances = tolerances or Tolerances()
    a, b = read_exr(ours), read_exr(reference)
    if diff is not None and _same_file(diff, (ours, reference)):
        raise SceneError(f"{diff}: the difference would overwrite an image it compares; give another name")
    left_out = _left_out(a, b, tolerances.ignore)
    obstacles = _obstacles(a, b, left_out)
    if obstacles:
        look = f"next:   caster info {shlex.quote(str(ours))}; caster info {shlex.quote(str(reference))}"
        messages = ("NOT COMPARABLE", *(f"      {text}" for text in (*obstacles, look)))
        return FileComparison(str(ours), str(reference), ignored=left_out, messages=messages)
    pixels = _Pixels.of(a, b, [name for name in a.channels if name not in left_out])
    judged = [_judge_hits(pixels)] if pixels.mask_channel else []
    judged += [_judge(pixels, group, names, tolerances) for group, names in _groups(pixels.names)]
    compared = _concluded(str(ours), str(reference), pixels, judged, tolerances, left_out, diff)
    if diff is not None:
        _write_diff(diff, pixels, judged, compared)
    return compared


# ---- may they be compared at all? ----


def _same_file(path: str | os.PathLike[str], others: Iterable[str | os.PathLike[str]]) -> bool:
    return os.path.exists(path) and any(os.path.samefile(path, other) for other in others)


def _left_out(a: Exr, b: Exr, patterns: Iterable[str]) -> tuple[str, ...]:
    names = sorted(a.channels.keys() | b.channels.keys())
    found: set[str] = set()
    for pattern in patterns:
        matches = [n for n in names if n in LAYERS.get(pattern, ()) or fnmatch.fnmatchcase(n, pattern)]
        if not matches:
            hint = suggestion(pattern, [*LAYERS, *names])
            has = ", ".join(names)
            raise SceneError(f"--ignore {pattern}: neither file has such a channel{hint}; they have {has}")
        found.update(matches)
    return tuple(sorted(found))


def _obstacles(a: Exr, b: Exr, left_out: Iterable[str]) -> list[str]:
    found = []
    size_a, size_b = _size(a), _size(b)
    if size_a != size_b:
        found.append(f"size: ours is {size_a[0]} x {size_a[1]}, the reference {size_b[0]} x {size_b[1]}")
    elif a.data_window != b.data_window:
        found.append(f"data window: ours shows pixels {a.data_window}, the reference {b.data_window}")
    ours, reference = a.channels.keys() - set(left_out), b.channels.keys() - set(left_out)
    for mine, other, whose in ((ours, reference, "ours"), (reference, ours, "the reference")):
        alone = sorted(mine - other)
        found += [f"channel {n} is in {whose} only{suggestion(n, sorted(other - mine))}" for n in alone]
    for n in sorted(ours & reference):
        if (a.channels[n].dtype == np.uint32) != (b.channels[n].dtype == np.uint32):
            kinds = (a.channels[n].dtype, b.channels[n].dtype)
            found.append(f"channel {n}: ours holds {kinds[0]}, the reference {kinds[1]}")
    if not ours & reference:
        found.append("no channel in common: nothing could be compared")
    elif found and ours ^ reference:
        found.append("to compare the rest: --ignore CHANNEL (or a pattern such as 'id.*')")
    return found


def _size(exr: Exr) -> tuple[int, int]:
    x0, y0, x1, y1 = exr.data_window
    return x1 - x0, y1 - y0


# ---- the pixels and what the reference tells about them ----


class Condition(NamedTuple):
    """How strongly a rounding shows at each pixel of the reference, all (h, w) float64; NaN where unknown."""

    depth: Array  # K u S / cos: depth error in scene units
    place: Array  # K u S more, across the ray: position error in scene units
    position: Array  # (h, w, 3)
    surface: Array  # a number for each surface, NaN on a miss


class _Pixels(NamedTuple):
    a: Exr
    b: Exr
    names: list[str]  # the channels to compare
    hit_ours: Array  # (h, w) bool; all True where no channel tells
    hit_reference: Array
    mask_channel: str  # "" where no channel tells
    condition: Condition | None

    @classmethod
    def of(cls, a: Exr, b: Exr, names: list[str]) -> _Pixels:
        hit_a, channel_a = hit_mask({name: a.channels[name] for name in names})
        hit_b, _ = hit_mask({name: b.channels[name] for name in names})
        if hit_a is None or hit_b is None:
            everywhere = np.ones(_size(b)[::-1], bool)
            return cls(a, b, names, everywhere, everywhere, "", None)
        return cls(a, b, names, hit_a, hit_b, channel_a, _condition(b, hit_b, _camera(a, b)))

    def values(self, names: Iterable[str]) -> tuple[Array, Array]:
        """Ours and the reference's, (h, w, c) float64."""
        return _stack(self.a, names), _stack(self.b, names)

    @property
    def same_mask(self) -> Array:
        return np.asarray(self.hit_ours == self.hit_reference)


def _stack(exr: Exr, names: Iterable[str]) -> Array:
    return np.stack([exr.channels[name].astype(np.float64) for name in names], -1)


def _camera(a: Exr, b: Exr) -> Mapping[str, Any]:
    """The camera of the reference's scene, of ours if the reference tells none."""
    for exr in (b, a):
        try:
            camera = json.loads(exr.provenance[SCENE_JSON])["camera"]
        except (KeyError, TypeError, ValueError):
            continue
        if isinstance(camera, dict):
            return camera
    return {}


def _condition(reference: Exr, hit: Array, camera: Mapping[str, Any]) -> Condition | None:
    if not {"depth.Z", *LAYERS["position"], *LAYERS["normal"]} <= reference.channels.keys():
        return None
    t = _stack(reference, ["depth.Z"])
    p, n = _stack(reference, LAYERS["position"]), _stack(reference, LAYERS["normal"])
    with np.errstate(all="ignore"):  # misses and planted NaN end as NaN, which is "unknown"
        d = _directions(camera, p)
        if d is None:
            return None
        cos = np.abs((n * d).sum(-1)) / np.linalg.norm(n, axis=-1)
        reach = np.abs(p - t * d).max(-1) + t[..., 0] + np.abs(p).max(-1)
        depth = np.where(hit, K * U * reach / cos, np.nan)
    shape = reference.channels.get("id.shape", np.zeros(hit.shape)).astype(np.float64)
    return Condition(depth, depth + K * U * reach, p, np.where(hit, shape, np.nan))


def _directions(camera: Mapping[str, Any], p: Array) -> Array | None:
    """Unit directions of the rays to p, (h, w, 3): parallel, or from the eye that all other cameras share."""
    try:
        eye = np.array(camera["eye"], np.float64)
        d = p - eye
        if camera.get("type") == "orthographic":
            along = camera.get("direction") or np.array(camera["look_at"], np.float64) - eye
            d = np.broadcast_to(np.array(along, np.float64), p.shape)
        return np.asarray(d / np.linalg.norm(d, axis=-1, keepdims=True))
    except (KeyError, TypeError, ValueError):
        return None  # another program's scene text


# ---- bounds: the allowed |ours - reference| of each value, (h, w, c), and the words that state it ----

Bound = tuple[Array, str]


def _bound(pixels: _Pixels, group: str, names: tuple[str, ...], tol: Tolerances) -> Bound:
    a, b = pixels.values(names)
    if any(pixels.b.channels[name].dtype == np.uint32 for name in names):
        return np.zeros_like(b), "exact"
    with np.errstate(all="ignore"):  # values that are not finite are judged before any bound
        stored = U * (np.abs(a) + np.abs(b))
        if group in ("depth", "position"):
            return _length_bound(pixels, group, tol, stored, b)
        if group in ("normal", "shading_normal"):
            return _normal_bound(pixels.condition, tol, stored, b)
        return _shade_bound(pixels.condition, group, tol, stored, b)


def _length_bound(pixels: _Pixels, group: str, tol: Tolerances, stored: Array, b: Array) -> Bound:
    condition = pixels.condition
    size = np.abs(b).max(-1, keepdims=True)
    if (
        group == "position"
    ):  # a hit near the world's origin is not nearer for that: its error is that of the ray
        size = np.maximum(size, _finite_depth(pixels.b, default=_typical(b)))
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
    t = _stack(exr, ["depth.Z"])
    return np.where(np.isfinite(t), np.abs(t), 0.0)


def _normal_bound(condition: Condition | None, tol: Tolerances, stored: Array, b: Array) -> Bound:
    if tol.normal_atol is not None:
        return np.full_like(b, tol.normal_atol), f"{tol.normal_atol:.3g}, as asked"
    return _read_at_hit(condition, b, stored + NORMAL_ATOL, 1.0, f"{NORMAL_ATOL:.2g}")


def _shade_bound(condition: Condition | None, group: str, tol: Tolerances, stored: Array, b: Array) -> Bound:
    typical = _typical(b)
    asked = (0.0, tol.uv_atol) if group == "uv" else (tol.color_rtol, tol.color_atol)
    rtol = (0.0 if group == "uv" else COLOR_RTOL) if asked[0] is None else asked[0]
    atol = TYPICAL_ATOL * typical if asked[1] is None else asked[1]
    plain, text = rtol * np.abs(b) + atol, f"{rtol:.2g} relative + {atol:.2g}"
    if asked not in ((0.0, None), (None, None)):
        return plain, f"{text}, as asked"
    return _read_at_hit(condition, b, stored + plain, typical, text)


def _typical(values: Array) -> float:
    known = np.abs(values[np.isfinite(values) & (values != 0.0)])
    return float(np.median(known)) if known.size else 0.0


def _read_at_hit(condition: Condition | None, field: Array, plain: Array, scale: float, text: str) -> Bound:
    """What varies over the surface is read where the hit is: add its slope times the error of the place."""
    if condition is None:
        return plain, text
    lever = (_slope(field, condition) * condition.place)[..., None]
    return plain + np.where(lever < UNRESOLVABLE * scale, lever, 0.0), f"{text} + slope K u S (1 + 1/cos)"


def _slope(field: Array, condition: Condition) -> Array:
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


# ---- judging ----


class _Judged(NamedTuple):
    result: GroupResult
    differ: Array  # (h, w) bool
    broken: Array  # (h, w) bool: a value is not finite and should be


def _groups(names: list[str]) -> list[tuple[str, tuple[str, ...]]]:
    """The groups that are there, in the order of LAYERS, then every other channel by itself; not `hit`."""
    known = [(group, tuple(n for n in layer if n in names)) for group, layer in LAYERS.items()]
    listed = {n for layer in LAYERS.values() for n in layer}
    groups = known + [(n, (n,)) for n in names if n not in listed]
    return [(group, members) for group, members in groups if members and group != "hit"]


def _judge_hits(pixels: _Pixels) -> _Judged:
    differ, broken = ~pixels.same_mask, np.zeros(pixels.hit_ours.shape, bool)
    a, b = pixels.hit_ours[..., None].astype(np.float64), pixels.hit_reference[..., None].astype(np.float64)
    if "A" in pixels.names:
        a, b = pixels.values(["A"])
        broken = ~np.isfinite(a[..., 0]) | ~np.isfinite(b[..., 0])
        differ = (differ | (a != b)[..., 0]) & ~broken
    worst = _worst(pixels, (pixels.mask_channel,), a, b, np.zeros_like(b), (differ | broken)[..., None])
    counts = _counts(pixels, differ, broken)
    return _Judged(GroupResult("hit", (pixels.mask_channel,), "exact", *counts, worst), differ, broken)


def _judge(pixels: _Pixels, group: str, names: tuple[str, ...], tol: Tolerances) -> _Judged:
    a, b = pixels.values(names)
    bound, text = _bound(pixels, group, names, tol)
    far_a = _depth_of_a_miss(group, a, pixels.hit_ours)
    far_b = _depth_of_a_miss(group, b, pixels.hit_reference)
    same = pixels.same_mask[..., None]
    broken = (~np.isfinite(a) & ~far_a) | (~np.isfinite(b) & ~far_b) | ((far_a != far_b) & same)
    with np.errstate(invalid="ignore"):  # inf - inf and NaN: both are in `broken`, or both images miss
        within = (np.abs(a - b) <= bound) | (far_a & far_b)
    differ = ~within & ~broken & same  # "not within", so that a NaN can never pass as "not beyond"
    worst = _worst(pixels, names, a, b, bound, (same & ~(far_a & far_b)) | broken)
    differing, unusable = differ.any(-1) & ~broken.any(-1), broken.any(-1)
    counts = _counts(pixels, differing, unusable)
    return _Judged(GroupResult(group, names, text, *counts, worst), differing, unusable)


def _counts(pixels: _Pixels, differ: Array, broken: Array) -> tuple[int, int, int]:
    agree = pixels.hit_ours & pixels.hit_reference & ~differ & ~broken
    return int(agree.sum()), int(differ.sum()), int(broken.sum())


def _depth_of_a_miss(group: str, values: Array, hit: Array) -> Array:
    """The only infinity that means something: the depth of a ray that hits nothing."""
    return np.asarray((values == np.inf) & ~hit[..., None] & (group == "depth"))


def _worst(
    pixels: _Pixels, names: tuple[str, ...], a: Array, b: Array, bound: Array, eligible: Array
) -> Worst | None:
    with np.errstate(all="ignore"):
        error = np.abs(a - b)
        ratio = np.where(error == 0.0, 0.0, error / bound)
    ratio = np.where(eligible, np.nan_to_num(ratio, nan=np.inf), 0.0)
    y, x, c = (int(i) for i in np.unravel_index(int(ratio.argmax()), ratio.shape))
    if ratio[y, x, c] == 0.0:
        return None
    x0, y0 = pixels.b.data_window[:2]
    numbers = (float(values[y, x, c]) for values in (a, b, error, bound))
    return Worst(names[c], x0 + x, y0 + y, *numbers)


# ---- the result ----


def _concluded(
    ours: str,
    reference: str,
    pixels: _Pixels,
    judged: list[_Judged],
    tol: Tolerances,
    left_out: tuple[str, ...],
    diff: str | os.PathLike[str] | None,
) -> FileComparison:
    bad = np.any([j.differ | j.broken for j in judged], axis=0)
    broken = np.any([j.broken for j in judged], axis=0)
    known = bool(pixels.mask_channel)
    either = int((pixels.hit_ours | pixels.hit_reference).sum())
    failed = bool(broken.any()) or int(bad.sum()) > tol.max_pixels
    exit_code = 1 if failed else 5 if not either and not tol.allow_empty else 0
    width, height = _size(pixels.b)
    result = FileComparison(
        ours,
        reference,
        width,
        height,
        int(pixels.hit_ours.sum()) if known else None,
        int(pixels.hit_reference.sum()) if known else None,
        either if known else None,
        int(bad.sum()),
        tol.max_pixels,
        tuple(j.result for j in judged),
        left_out,
        exit_code,
    )
    return replace(result, messages=tuple(_messages(result, pixels, diff)))


def _messages(result: FileComparison, pixels: _Pixels, diff: str | os.PathLike[str] | None) -> list[str]:
    notes = [*_half_notes(pixels), *_scene_notes(pixels)]
    if result.exit_code == 5:
        return [
            "EMPTY  neither image hits anything, so nothing was compared",
            "      if that is what the scene shows: --allow-empty",
            *notes,
        ]
    if result.exit_code == 1:
        bad = [g for g in result.groups if g.differ or g.non_finite]
        return [*(_failure(g, result) for g in bad), *_where_to_look(bad[0], result, pixels, diff), *notes]
    if result.differing_pixels:
        return [f"PASS  {result.differing_pixels} pixels differ, {result.allowed_pixels} may", *notes]
    ratio, group = max(((g.worst.ratio, g.name) for g in result.groups if g.worst), default=(0.0, ""))
    nearest = f", worst {ratio:.2g}x its bound ({group})" if group else ""
    return [f"PASS  {_hit_pixels(result)} agree in {len(pixels.names)} channels{nearest}", *notes]


def _hit_pixels(result: FileComparison) -> str:
    if result.hit_either is None:
        return f"{result.width * result.height} pixels"
    return f"{result.hit_either} hit pixels"


def _failure(group: GroupResult, result: FileComparison) -> str:
    total = result.width * result.height if result.hit_either is None else result.hit_either
    share = f" ({100.0 * group.differ / total:.2g} %)" if total else ""
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
    group: GroupResult, result: FileComparison, pixels: _Pixels, diff: str | os.PathLike[str] | None
) -> list[str]:
    at = f"{group.worst.x} {group.worst.y}" if group.worst else "0 0"
    scene = next(filter(None, (exr.provenance.get(SCENE) for exr in (pixels.a, pixels.b))), "")
    look = f"      look:   {diff}, channel class.I ({CLASSES})"
    replay = f"      replay: mitsuba-ref probe {shlex.quote(scene)} {at}"
    info = f"      next:   caster info {shlex.quote(result.ours)}"
    return [*([look] if diff is not None else []), replay if scene and scene.isprintable() else info]


def _half_notes(pixels: _Pixels) -> list[str]:
    stored = (("ours", pixels.a), ("the reference", pixels.b))
    half = [who for who, exr in stored if any(exr.channels[n].dtype == np.float16 for n in pixels.names)]
    return [f"note: {who} holds halves, 11 bits a number; write float32 or state a tolerance" for who in half]


def _scene_notes(pixels: _Pixels) -> list[str]:
    hashes = {exr.provenance.get(SCENE_HASH) for exr in (pixels.a, pixels.b)} - {None}
    return (
        ["note: the files say that they show different scenes (caster/scene_sha256)"]
        if len(hashes) > 1
        else []
    )


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


def _write_diff(
    path: str | os.PathLike[str], pixels: _Pixels, judged: list[_Judged], compared: FileComparison
) -> None:
    largest = float(np.finfo(np.float32).max)
    channels = {}
    for name in pixels.names:
        a, b = (values[..., 0] for values in pixels.values([name]))
        with np.errstate(invalid="ignore"):
            signed = np.where(a == b, 0.0, a - b)  # inf on both sides is no difference
        channels[name] = np.where(np.isfinite(signed), np.clip(signed, -largest, largest), signed)
    classes = np.where(pixels.hit_ours | pixels.hit_reference, AGREE, MISS)
    classes[np.any([j.differ for j in judged], axis=0)] = DIFFER
    classes[~pixels.same_mask] = HIT_MISS
    classes[np.any([j.broken for j in judged], axis=0)] = NON_FINITE
    channels["class.I"] = classes.astype(np.uint32)
    provenance = {
        "kind": "ours minus reference",
        "class": CLASSES,
        "ours": compared.ours,
        "reference": compared.reference,
    }
    windows = {"data_window": pixels.b.data_window, "display_window": pixels.b.display_window}
    write_exr(path, channels, provenance, **windows)

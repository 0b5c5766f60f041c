"""Comparison of two EXR files pixel by pixel; NaN, renamed channels, another window or a missed pixel never pass."""

import fnmatch
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from caster.aovs import Aovs
from caster.description.errors import SceneError, error_prefix, suggestion
from caster.description.input_files import FileName
from caster.image.channels import aovs_to_channels
from caster.image.exr import Exr, read_exr
from caster.system.process import DIFFERENCES, NOTHING_SELECTED, OK
from mitsuba_ref.error_model.bounds import error_over_bound
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.error_model.tolerances import Tolerances
from mitsuba_ref.exr_compare import comparison_page
from mitsuba_ref.exr_compare.comparison_result import FileComparison, GroupResult, Worst
from mitsuba_ref.exr_compare.conventions import Reading, check_maps, hints, is_ours, to_our_conventions
from mitsuba_ref.exr_compare.pixel_bounds import LAYERS, SCENE_HASH, ExrPair, bound_of, scene_in
from mitsuba_ref.report.html_report import refuse_page_of_others

__all__ = ["Reading", "Tolerances", "compare_exr"]

Image = FileName | Mapping[str, Array]
SIDES = ("ours", "the reference")
SCENE = "caster/scene"  # provenance: the scene's path


class Judged(NamedTuple):
    """One quantity, compared with its bound."""

    result: GroupResult
    bad: Array  # (h, w) bool: pixels that differ, or where a value should be finite and is not
    ratio: Array  # (h, w) error over bound


def compare_exr(
    ours: Image,
    reference: Image,
    tolerances: Tolerances | None = None,
    *,
    html: FileName | None = None,
    reading: Reading | None = None,
) -> FileComparison:
    """Compare two images pixel by pixel, matching channels by name.

    Each is the path of an EXR file, Aovs of `caster.render`, or arrays by the name of a channel or AOV.
    html: a folder for a page that shows both images; none is written when they are not comparable.
    reading: how to interpret files of other programs.
    Raises FileMissing or UnreadableExr for an input, OutputError for html, Unclear for a file that can be read in two
    ways, SceneError for an `ignore` that matches no channel.
    """
    if html is not None:
        page = Path(html) / "index.html"  # of an earlier run, which would be taken for this one's
        refuse_page_of_others(page)
        page.unlink(missing_ok=True)
    reading, sources = reading or Reading(), (ours, reference)
    named = zip(sources, SIDES, strict=True)
    names = [str(each) if isinstance(each, str | os.PathLike) else who for each, who in named]
    files = [as_exr(each) for each in sources]
    check_maps(reading.maps, *(exr.channels for exr in files))
    converted, stated = list[Exr](), list[str]()
    both_foreign = not any(map(is_ours, files))
    for who, exr, other in zip(SIDES, files, files[::-1], strict=True):
        with error_prefix(who):
            kept = other.channels if both_foreign else ()
            found, steps = to_our_conventions(exr, reading, [scene_in(other)], kept)
        converted.append(found)
        stated += [f"{who}: {step}" for step in steps]
    a, b = converted
    foreign = [i for i in (0, 1) if converted[i] is not files[i]]
    alone = sorted(a.channels.keys() ^ b.channels.keys()) if foreign else []
    stated += [f"not compared, since only one file has them: {', '.join(alone)}"] if alone else []
    tolerances = tolerances or Tolerances()
    ignored = ignored_channels(a, b, tolerances.ignore)
    about: dict[str, Any] = {"ours": names[0], "reference": names[1], "ignored": ignored, "stated": tuple(stated)}
    left_out = {*ignored, *alone}
    if reasons := tuple(incompatibilities(a, b, left_out, other_scene=tolerances.other_scene)):
        return FileComparison(**about, reasons=reasons)

    # Every pixel of both, in our conventions.
    pair = ExrPair.of(a, b, [name for name in a.channels if name not in left_out])
    judged = [judge(pair, group, channels, tolerances) for group, channels in present_groups(pair)]
    groups, bad, _ = zip(*judged, strict=True)
    differing = int(np.any(bad, axis=0).sum())
    if pair.mask_channel:
        empty = not (pair.hit_ours | pair.hit_reference).any()
    else:
        empty = not any(exr.channels[name].any() for exr in (a, b) for name in pair.names)
    failed = any(group.non_finite for group in groups) or differing > tolerances.max_pixels
    height, width = pair.hit_ours.shape
    more = (f"{SIDES[i]}: {hint}" for i in foreign for hint in hints(converted[i], converted[1 - i], reading))
    result = FileComparison(
        **about,
        width=width,
        height=height,
        hit_ours=int(pair.hit_ours.sum()),
        hit_reference=int(pair.hit_reference.sum()),
        hit_either=int((pair.hit_ours | pair.hit_reference).sum()),
        hit_channel=pair.mask_channel,
        differing_pixels=differing,
        allowed_pixels=tolerances.max_pixels,
        compared=len(pair.names),
        groups=groups,
        exit_code=DIFFERENCES if failed else NOTHING_SELECTED if empty else OK,
        hints=tuple(more) if failed else (),
        scene=next((exr.provenance[SCENE] for exr in (a, b) if SCENE in exr.provenance), ""),
    )
    if html is None:
        return result
    shown = [each for each in judged if each.result.name != "hit" or each.result.channels == LAYERS["hit"]]
    layers = comparison_page.layers_of(pair, ((each.result, each.ratio) for each in shown))
    result = result.model_copy(update={"measures": tuple(comparison_page.measures(pair, layers)), "html": str(html)})
    comparison_page.write_comparison(Path(html), result, pair, layers)
    return result


def as_exr(image: Image) -> Exr:
    """The image of a file, or of arrays (h, w) or (h, w, c) by the name of a channel or AOV, floats as float32.

    Raises as `read_exr`, and TypeError.
    """
    if isinstance(image, str | os.PathLike):
        return read_exr(image)
    if not isinstance(image, Mapping) or not image:
        raise TypeError(f"expected the path of an EXR file, or arrays by name, got {image!r:.60}")
    found = aovs_to_channels(image) if isinstance(image, Aovs) else dict(_channels(image))
    channels = {name: a.astype(np.float32) if a.dtype.kind == "f" else a for name, a in found.items()}
    height, width = next(iter(channels.values())).shape
    return Exr(channels, {}, (0, 0, width, height), (0, 0, width, height))


def _channels(arrays: Mapping[str, Array]) -> Iterator[tuple[str, Array]]:
    for name, a in arrays.items():
        if a.ndim == 2:
            yield LAYERS.get(name, (name,))[0], a
        else:
            planes = np.moveaxis(a, -1, 0)
            yield from zip(LAYERS.get(name) or [f"{name}.{c}" for c in "RGBA"[: len(planes)]], planes, strict=True)


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
    (x0, y0, x1, y1), (u0, v0, u1, v1) = a.data_window, b.data_window
    if (x1 - x0, y1 - y0) != (u1 - u0, v1 - v0):
        yield f"size: ours is {x1 - x0} x {y1 - y0}, the reference {u1 - u0} x {v1 - v0}; render both at one size"
    elif not other_scene and len({exr.provenance.get(SCENE_HASH) for exr in (a, b)} - {None}) > 1:
        yield f"the files are of different scenes, by their attributes ({SCENE_HASH}); --other-scene compares anyway"
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
    """Hits, the groups that are present in the order of LAYERS, other colours, then every other channel by itself."""
    groups = {group: tuple(n for n in layer if n in pair.names) for group, layer in LAYERS.items()}
    others = [n for n in pair.names if not any(n in layer for layer in LAYERS.values())]
    for name in others:
        color = tuple(name[:-1] + letter for letter in "RGB")
        if name in color and set(color) <= set(others):
            groups[f"{name[:-1]}RGB"] = color
        else:
            groups[name] = (name,)
    groups["hit"] = (pair.mask_channel,) if pair.mask_channel else ()
    return [(group, channels) for group, channels in groups.items() if channels]


# ---- each quantity against its bound ----


def judge(pair: ExrPair, group: str, names: tuple[str, ...], tol: Tolerances) -> Judged:
    """Compare one quantity with its bound: hits in every pixel, all else where both images hit or both miss."""
    if group == "hit":
        masks = (mask[..., None].astype(np.float64) for mask in (pair.hit_ours, pair.hit_reference))
        a, b = pair.values(names) if names == LAYERS["hit"] else masks
        bound, text, where = np.zeros_like(b), "exact", np.ones_like(b, bool)
    else:
        (a, b), (bound, text) = pair.values(names), bound_of(pair, group, names, tol)
        where = (pair.hit_ours == pair.hit_reference)[..., None]
    # Infinity is a valid value only as the depth of a ray that hits nothing.
    far_a, far_b = (
        (values == np.inf) & ~hit[..., None] & (group == "depth")
        for values, hit in ((a, pair.hit_ours), (b, pair.hit_reference))
    )
    broken = (~np.isfinite(a) & ~far_a) | (~np.isfinite(b) & ~far_b) | ((far_a != far_b) & where)
    with np.errstate(invalid="ignore"):  # inf - inf and NaN: both are in `broken`, or both images miss
        error = np.abs(a - b)
    within = (error <= bound) | (far_a & far_b)
    wrong = ~within & ~broken & where  # "not within", so that a NaN can never pass as "not beyond"
    ratio = np.where((where & ~(far_a & far_b)) | broken, error_over_bound(error, bound), 0.0)
    worst = _worst(pair, names, {"ours": a, "reference": b, "error": error, "bound": bound, "ratio": ratio})
    broken = broken.any(-1)
    differ = wrong.any(-1) & ~broken
    agree = pair.hit_ours & pair.hit_reference & ~differ & ~broken
    counts = {"agree": int(agree.sum()), "differ": int(differ.sum()), "non_finite": int(broken.sum())}
    result = GroupResult(name=group, channels=names, bound=text, worst=worst, **counts)
    return Judged(result, differ | broken, ratio.max(-1))


def _worst(pair: ExrPair, names: tuple[str, ...], numbers: dict[str, Array]) -> Worst | None:
    error, ratio = np.nan_to_num(numbers["error"], nan=np.inf), numbers["ratio"]
    among = np.where(ratio == ratio.max(), error, -1.0)  # where no error is allowed: largest
    at = y, x, c = np.unravel_index(int(among.argmax()), ratio.shape)
    if ratio[at] == 0.0:
        return None
    x0, y0 = pair.reference.data_window[:2]
    return Worst(
        channel=names[c], x=x0 + int(x), y=y0 + int(y), **{name: float(values[at]) for name, values in numbers.items()}
    )

"""One scene against its stored reference."""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from caster import __version__
from caster.channels import aovs_of, channels_of, provenance
from caster.exr import UnreadableExr, write_exr
from caster.rendering import evaluate, film_window
from caster.scene import Scene
from caster.wording import FileMissing, SceneError
from mitsuba_ref.baselines.changes import changes, comparable, lines
from mitsuba_ref.baselines.reference_file import (
    AOVS,
    CLASS,
    EITHER_WAY,
    VARIANT,
    Reference,
    RefusedReference,
    as_stored,
    check_fits,
    rendered,
    stored,
)
from mitsuba_ref.bounds import bounds_of
from mitsuba_ref.campaign import Entry
from mitsuba_ref.compare import compare
from mitsuba_ref.exr.compare import COLOR_RTOL, Tolerances, compare_exr
from mitsuba_ref.jobs import Crash
from mitsuba_ref.lambert import Hit, lit
from mitsuba_ref.meeting import KU
from mitsuba_ref.model import model_of
from mitsuba_ref.pair import our_view
from mitsuba_ref.pixels import Pixels, flat
from mitsuba_ref.rays import share

COLORS = ("R", "G", "B")


@dataclass(frozen=True)
class Checked:
    """What came of it. refused: approving anew is the way out, of a reference that is missing, altered or stale, or
    whose bits Mitsuba gives no more. missing: there is none that can be read, so nothing was checked."""

    name: str
    reference: str
    ok: bool
    words: tuple[str, ...]
    refused: bool = False
    missing: bool = False

    def lines(self) -> Iterator[str]:
        head, *rest = self.words
        yield f"{'PASS' if self.ok else 'FAIL'}  {self.name}  {head}"
        yield from (f"      {line}" for line in rest)


def check(entry: Entry, args: argparse.Namespace, place: Path) -> Checked:
    """args: of `mitsuba-ref check`; place: a folder for files that nobody needs afterwards."""
    path = Path(args.references) / f"{entry.name}.exr"
    try:
        before = stored(path)
        check_fits(before, entry.scene, args.variant)
    except FileMissing as error:
        words = str(error) if isinstance(error, UnreadableExr) else f"{path}: there is no reference"
        told = (f"{words}; nothing was checked",)
        return Checked(entry.name, str(path), False, told, refused=True, missing=True)
    except RefusedReference as error:
        return Checked(entry.name, str(path), False, (f"{path}: {error}",), refused=True)
    try:
        return _fresh(entry, path, before) if args.fresh else _ours(entry, path, before, args, place)
    except SceneError as error:
        return Checked(entry.name, str(path), False, (str(error),))


def _ours(entry: Entry, path: Path, before: Reference, args: argparse.Namespace, place: Path) -> Checked:
    """Within the bounds of `compare`, but for the pixels where, on approval, more than one answer was right."""
    scene, ours = entry.scene, place / f"{entry.name}.exr"
    film = (0, 0, scene.film.width, scene.film.height)
    about = provenance(scene, __version__, entry.path)
    left_out, hit = np.isin(before.channels[CLASS], EITHER_WAY), before.channels["A"] != 0.0
    if hit.any() and not (hit & ~left_out).any():
        why = f"nothing to compare: more than one answer is right at all {hit.sum()} pixels that are hit"
        return Checked(entry.name, str(path), False, (why,))
    images, geometry, light = held_to_bounds(scene, before)
    shown = {CLASS: before.channels[CLASS]}
    for name, plane in images.items():
        passes = left_out | (light if name in COLORS else geometry)
        shown[name] = np.where(passes, before.channels[name], as_stored(plane))
    write_exr(ours, shown, about, data_window=scene.film.window, display_window=film)
    result = compare_exr(ours, path, Tolerances(max_pixels=args.max_pixels, ignore=(CLASS,)))
    words = [line.replace(str(ours), f"{entry.name} of ours") for line in result.messages]
    head = words[0].removeprefix("PASS  ").removeprefix("FAIL  ")
    head += (
        f"; {left_out.sum()} pixels with more than one right answer not compared" if left_out.any() else ""
    )
    return Checked(entry.name, str(path), result.ok, (head, *(line.strip() for line in words[1:])))


def _fresh(entry: Entry, path: Path, before: Reference) -> Checked:
    """To the bit, by the variant that rendered the stored one."""
    variant = before.about[VARIANT]
    now = rendered(entry.scene, entry.path, variant=variant, command="")
    if isinstance(now, Crash):
        return Checked(
            entry.name, str(path), False, (f"Mitsuba ended without an answer ({now.exit}): {now.headline}",)
        )
    before, now = without_classes(before), without_classes(now)
    if comparable(before, now) and not changes(before, now):
        return Checked(entry.name, str(path), True, (f"a fresh render by {variant} has the same bits",))
    return Checked(
        entry.name,
        str(path),
        False,
        (f"a fresh render by {variant} has other bits", *lines(before, now)),
        refused=True,
    )


def held_to_bounds(scene: Scene, before: Reference) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
    """(our channels, along the rays and on the geometry that Mitsuba was given; (h, w) bool: the geometry of the pixel
    is within the bounds that `validate` derives; (h, w) bool: its light is, too)."""
    rays = share(scene)
    view, window = our_view(scene, rays), film_window(scene)
    ours = evaluate(view, AOVS, window)
    model = model_of(scene, view.packed, rays)
    o, d = rays.o.astype(np.float64), rays.d.astype(np.float64)
    t = view.nearest.t
    bounds = bounds_of(model, view.nearest.prim, o, d, t)
    with np.errstate(invalid="ignore"):
        point = o + t[:, None] * d
    pixels = Pixels(ours, aovs_of(before.channels), bounds, t, np.linalg.norm(d, axis=1), point)
    geometry = compare(pixels, scene.checks).agrees
    light = geometry & light_within(scene, pixels, Hit(point, d, flat(ours, "shape_id"), bounds.at))
    shape = window.height, window.width
    return channels_of(ours), geometry.reshape(shape), light.reshape(shape)


def light_within(scene: Scene, pixels: Pixels, hit: Hit) -> np.ndarray:
    """(n,) bool: both values of diffuse are within what all lights may be off by, whether in shadow or not."""
    rows = np.flatnonzero(pixels.both_hit)
    there = Hit(hit.p[rows], hit.d[rows], hit.shape[rows], hit.at.taken(rows))
    ours, theirs = (values[rows] for values in pixels.pair("diffuse"))
    off = COLOR_RTOL * np.abs(theirs)
    for each in scene.lights:
        if each.type != "ambient":
            off = off + lit(scene, each, there, KU).error
    within = np.zeros(len(hit.p), bool)
    within[rows] = (np.abs(ours - theirs) <= off).all(axis=1)
    return within


def without_classes(found: Reference) -> Reference:
    """Mitsuba's own channels: a class is as much of our doing."""
    return replace(found, channels={name: plane for name, plane in found.channels.items() if name != CLASS})

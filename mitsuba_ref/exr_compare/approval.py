"""One scene against its stored reference."""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from caster import __version__
from caster.description.errors import FileMissing, SceneError
from caster.image.channels import aovs_to_channels, channels_to_aovs, provenance
from caster.image.exr import UnreadableExr, write_exr
from caster.rendering.images import evaluate, film_window
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import PixelPairs, aov_rows, reference_bounds
from mitsuba_ref.error_model.exr_tolerances import COLOR_RTOL, Tolerances
from mitsuba_ref.error_model.intersections import KU
from mitsuba_ref.error_model.lambert import ShadingPoints, light_contribution
from mitsuba_ref.error_model.scene_model import model_of
from mitsuba_ref.exr_compare.approved_reference import (
    AMBIGUOUS_CLASSES,
    AOVS,
    CLASS_CHANNEL,
    SCENE_HASH,
    VARIANT,
    Reference,
    UnusableReference,
    channel_changes,
    check_matches_scene,
    comparable,
    describe_changes,
    load_reference,
    render_fresh,
    to_stored_type,
)
from mitsuba_ref.exr_compare.two_files import compare_exr
from mitsuba_ref.judge.comparison import compare
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.rays import shared_rays
from mitsuba_ref.runner.scene_runner import SceneEntry
from mitsuba_ref.subjects.ours import cast_ours

COLORS = ("R", "G", "B")


@dataclass(frozen=True)
class ReferenceCheck:
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


def check_scene(entry: SceneEntry, args: argparse.Namespace, place: Path) -> ReferenceCheck:
    """args: of `mitsuba-ref check`; place: a folder for files that nobody needs afterwards."""
    path = Path(args.references) / f"{entry.name}.exr"
    try:
        before = load_reference(path)
        check_matches_scene(before, entry.scene, args.variant)
    except FileMissing as error:
        words = str(error) if isinstance(error, UnreadableExr) else f"{path}: there is no reference"
        told = (f"{words}; nothing was checked",)
        return ReferenceCheck(entry.name, str(path), False, told, refused=True, missing=True)
    except UnusableReference as error:
        return ReferenceCheck(entry.name, str(path), False, (f"{path}: {error}",), refused=True)
    try:
        return _fresh(entry, path, before) if args.fresh else _ours(entry, path, before, args, place)
    except SceneError as error:
        return ReferenceCheck(entry.name, str(path), False, (str(error),))


def _ours(
    entry: SceneEntry, path: Path, before: Reference, args: argparse.Namespace, place: Path
) -> ReferenceCheck:
    """Within the bounds of `compare`, but for the pixels where, on approval, more than one answer was right."""
    scene, ours = entry.scene, place / f"{entry.name}.exr"
    film = (0, 0, scene.film.width, scene.film.height)
    about = provenance(scene, __version__, entry.path)
    left_out, hit = np.isin(before.channels[CLASS_CHANNEL], AMBIGUOUS_CLASSES), before.channels["A"] != 0.0
    if hit.any() and not (hit & ~left_out).any():
        why = f"nothing to compare: more than one answer is right at all {hit.sum()} pixels that are hit"
        return ReferenceCheck(entry.name, str(path), False, (why,))
    images, geometry, light = compare_with_reference(scene, before)
    shown = {CLASS_CHANNEL: before.channels[CLASS_CHANNEL]}
    for name, plane in images.items():
        passes = left_out | (light if name in COLORS else geometry)
        shown[name] = np.where(passes, before.channels[name], to_stored_type(plane))
    write_exr(ours, shown, about, data_window=scene.film.window, display_window=film)
    result = compare_exr(ours, path, Tolerances(max_pixels=args.max_pixels, ignore=(CLASS_CHANNEL,)))
    words = [line.replace(str(ours), f"{entry.name} of ours") for line in result.messages]
    head = words[0].removeprefix("PASS  ").removeprefix("FAIL  ")
    head += (
        f"; {left_out.sum()} pixels with more than one right answer not compared" if left_out.any() else ""
    )
    return ReferenceCheck(entry.name, str(path), result.ok, (head, *(line.strip() for line in words[1:])))


def _fresh(entry: SceneEntry, path: Path, before: Reference) -> ReferenceCheck:
    """To the bit, by the variant that rendered the stored one."""
    variant = before.about[VARIANT]
    now = render_fresh(entry.scene, entry.path, variant=variant, command="")
    if isinstance(now, Crash):
        return ReferenceCheck(
            entry.name, str(path), False, (f"Mitsuba ended without an answer ({now.exit}): {now.headline}",)
        )
    before, now = without_classes(before), without_classes(now)
    if comparable(before, now) and not channel_changes(before, now):
        return ReferenceCheck(
            entry.name, str(path), True, (f"a fresh render by {variant} has the same bits",)
        )
    return ReferenceCheck(
        entry.name,
        str(path),
        False,
        (f"a fresh render by {variant} has other bits", *describe_changes(before, now)),
        refused=True,
    )


def compare_with_reference(
    scene: Scene, before: Reference
) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
    """(our channels, along the rays and on the geometry that Mitsuba was given; (h, w) bool: the geometry of the pixel
    is within the bounds that `validate` derives; (h, w) bool: its light is, too)."""
    rays = shared_rays(scene)
    view, window = cast_ours(scene, rays), film_window(scene)
    ours = evaluate(view, AOVS, window)
    model = model_of(scene, view.packed, rays)
    o, d = rays.o.astype(np.float64), rays.d.astype(np.float64)
    t = view.nearest.t
    bounds = reference_bounds(model, view.nearest.prim, o, d, t)
    with np.errstate(invalid="ignore"):
        point = o + t[:, None] * d
    pixels = PixelPairs(ours, channels_to_aovs(before.channels), bounds, t, np.linalg.norm(d, axis=1), point)
    geometry = compare(pixels, scene.checks).agrees
    light = geometry & lighting_agrees(
        scene, pixels, ShadingPoints(point, d, aov_rows(ours, "shape_id"), bounds.at)
    )
    shape = window.height, window.width
    return aovs_to_channels(ours), geometry.reshape(shape), light.reshape(shape)


def lighting_agrees(scene: Scene, pixels: PixelPairs, hit: ShadingPoints) -> np.ndarray:
    """(n,) bool: both values of diffuse are within what all lights may be off by, whether in shadow or not."""
    rows = np.flatnonzero(pixels.both_hit)
    there = ShadingPoints(hit.p[rows], hit.d[rows], hit.shape[rows], hit.at.take(rows))
    ours, theirs = (values[rows] for values in pixels.pair("diffuse"))
    off = COLOR_RTOL * np.abs(theirs)
    for each in scene.lights:
        if each.type != "ambient":
            off = off + light_contribution(scene, each, there, KU).error
    within = np.zeros(len(hit.p), bool)
    within[rows] = (np.abs(ours - theirs) <= off).all(axis=1)
    return within


def without_classes(found: Reference) -> Reference:
    """Mitsuba's own channels: a class is as much of our doing."""
    return replace(
        found, channels={name: plane for name, plane in found.channels.items() if name != CLASS_CHANNEL}
    )


# Which references are to be written: missing ones, changed ones, or all.


MISSING, CHANGED, ALL = MODES = ("missing", "changed", "all")


@dataclass(frozen=True)
class Proposal:
    """One scene: what became of its reference, and what would be written."""

    name: str
    path: Path
    status: str  # missing, changed, stale, damaged, same, kept, failed
    write: bool
    details: tuple[str, ...] = ()
    fresh: Reference | None = None


def propose(entry: SceneEntry, folder: Path, mode: str, variant: str | None, command: str) -> Proposal:
    """Render the scene unless nobody would write it, and hold it against what is stored."""
    path = folder / f"{entry.name}.exr"
    if mode == MISSING and path.exists():
        return Proposal(entry.name, path, "kept", False, ("it is there; --update missing looks no further",))
    fresh = render_fresh(entry.scene, entry.path, variant=variant, command=command)
    if isinstance(fresh, Crash):
        words = f"Mitsuba ended without an answer ({fresh.exit}): {fresh.headline}"
        return Proposal(entry.name, path, "failed", False, (words,))
    if not path.exists():
        hit = int((fresh.channels["A"] != 0.0).sum())
        what = f"{hit} of {fresh.channels['A'].size} pixels hit, {len(fresh.channels)} channels"
        return Proposal(entry.name, path, "missing", True, (what,), fresh)
    try:
        before = load_reference(path)
    except (UnusableReference, UnreadableExr) as error:
        return Proposal(entry.name, path, "damaged", True, (str(error),), fresh)
    return _held_against(before, fresh, entry.name, path, mode)


def _held_against(before: Reference, fresh: Reference, name: str, path: Path, mode: str) -> Proposal:
    found = tuple(describe_changes(before, fresh))
    if before.about.get(SCENE_HASH) != fresh.about[SCENE_HASH]:
        same = "the scene has changed, no pixel has" if not found else "the scene has changed"
        return Proposal(name, path, "stale", True, (same, *found), fresh)
    if not comparable(before, fresh) or channel_changes(before, fresh):
        return Proposal(name, path, "changed", True, found, fresh)
    return Proposal(name, path, "same", mode == ALL and before.digest() != fresh.digest(), found, fresh)


def unused_references(folder: Path, names: set[str]) -> list[str]:
    """Files of the folder that are named after none of the scenes."""
    return (
        sorted(path.name for path in folder.glob("*.exr") if path.stem not in names)
        if folder.is_dir()
        else []
    )

"""Comparison of a scene with its approved reference, and proposals of new references."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import TypeAdapter, computed_field
from pydantic.dataclasses import dataclass

from caster import __version__
from caster.description.errors import FileMissing, SceneError
from caster.image.channels import aovs_to_channels, channels_to_aovs, provenance
from caster.image.exr import UnreadableExr, write_exr
from caster.rendering.images import film_window
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import aov_rows, reference_bounds
from mitsuba_ref.error_model.lambert import ShadingPoints, light_contribution
from mitsuba_ref.error_model.tolerances import COLOR_RTOL, KU, Tolerances
from mitsuba_ref.exr_compare.approved_reference import (
    AMBIGUOUS_CLASSES,
    AOVS,
    CLASS_CHANNEL,
    PROCESSOR,
    SCENE_HASH,
    VARIANT,
    VERSIONS,
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
from mitsuba_ref.judge.comparison import PixelPairs, compare
from mitsuba_ref.judge.diffuse import materials_of
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.shared_input import model_of, shared_rays
from mitsuba_ref.subjects.subject import answer_of_view, cast_ours

COLORS = ("R", "G", "B")


@dataclass(frozen=True)
class ReferenceCheck:
    """Result of one scene. refused: the reference has to be approved again, since it is missing, altered or stale, or
    Mitsuba no longer gives its bits. missing: there is none that can be read, so nothing was checked."""

    name: str
    reference: str
    ok: bool
    words: tuple[str, ...]
    refused: bool = False
    missing: bool = False

    def lines(self) -> Iterator[str]:
        """For a terminal."""
        head, *rest = self.words
        yield f"{'PASS' if self.ok else 'FAIL'}  {self.name}  {head}"
        yield from (f"      {line}" for line in rest)


@dataclass(frozen=True)
class ReferenceChecks:
    """Results of all scenes: the JSON of `mitsuba-ref check --json`."""

    scenes: tuple[ReferenceCheck, ...]

    @computed_field  # type: ignore[prop-decorator]
    @property
    def ok(self) -> bool:
        """Whether every scene passes."""
        return all(scene.ok for scene in self.scenes)

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        record: dict[str, Any] = TypeAdapter(ReferenceChecks).dump_python(self, mode="json")
        return record


def check_scene(
    scene: Scene, name: str, source: str, path: Path, scratch: Path, variant: str | None, fresh: bool, max_pixels: int
) -> ReferenceCheck:
    """Compare our render, or with `fresh` Mitsuba's, with the reference at path.

    source: the scene's file; scratch: a folder for temporary files; variant: the required one, if any.
    """

    def failed(*words: str, refused: bool = False, missing: bool = False) -> ReferenceCheck:
        return ReferenceCheck(name, str(path), False, words, refused=refused, missing=missing)

    try:
        before = load_reference(path)
        check_matches_scene(before, scene, variant)
    except FileMissing as error:
        text = str(error) if isinstance(error, UnreadableExr) else f"{path}: there is no reference"
        return failed(f"{text}; nothing was checked", refused=True, missing=True)
    except UnusableReference as error:
        return failed(f"{path}: {error}", refused=True)
    try:
        if fresh:
            return _check_fresh(scene, name, source, path, before)
        return _check_ours(scene, name, source, path, before, scratch, max_pixels)
    except SceneError as error:
        return failed(str(error))


def _check_ours(
    scene: Scene, name: str, source: str, path: Path, before: Reference, scratch: Path, max_pixels: int
) -> ReferenceCheck:
    """Within the bounds of `compare`, except at pixels where more than one answer was right on approval."""
    ours = scratch / f"{name}.exr"
    film = (0, 0, scene.film.width, scene.film.height)
    about = provenance(scene, __version__, source)
    ambiguous = np.isin(before.channels[CLASS_CHANNEL], AMBIGUOUS_CLASSES)
    hit = before.channels["A"] != 0.0
    if hit.any() and not (hit & ~ambiguous).any():
        why = f"nothing to compare: more than one answer is right at all {hit.sum()} pixels that are hit"
        return ReferenceCheck(name, str(path), False, (why,))
    images, geometry, light = compare_with_reference(scene, before)
    shown = {CLASS_CHANNEL: before.channels[CLASS_CHANNEL]}
    for channel, plane in images.items():
        passes = ambiguous | (light if channel in COLORS else geometry)
        shown[channel] = np.where(passes, before.channels[channel], to_stored_type(plane))
    write_exr(ours, shown, about, data_window=scene.film.window, display_window=film)
    result = compare_exr(ours, path, Tolerances(max_pixels=max_pixels, ignore=(CLASS_CHANNEL,)))
    head, *rest = (line.replace(str(ours), f"{name} of ours") for line in result.messages)
    head = head.removeprefix("PASS  ").removeprefix("FAIL  ")
    if ambiguous.any():
        head += f"; {ambiguous.sum()} pixels with more than one right answer not compared"
    return ReferenceCheck(name, str(path), result.ok, (head, *(line.strip() for line in rest)))


def _check_fresh(scene: Scene, name: str, source: str, path: Path, before: Reference) -> ReferenceCheck:
    """To the bit, by the variant that rendered the stored one; but for rounding, where another processor did."""
    variant = before.about[VARIANT]
    fresh = render_fresh(scene, source, variant=variant, command="")
    if isinstance(fresh, Crash):
        why = f"Mitsuba ended without an answer ({fresh.exit}): {fresh.headline}"
        return ReferenceCheck(name, str(path), False, (why,))
    stored = before
    before, now = without_classes(stored), without_classes(fresh)
    if comparable(before, now) and not channel_changes(before, now):
        same = f"a fresh render by {variant} has the same bits"
        return ReferenceCheck(name, str(path), True, (same,))
    ok = differ_by_processor(scene, stored, fresh)
    why = f"; both are {WITHIN_BOUNDS}" if ok else ""
    words = (f"a fresh render by {variant} has other bits{why}", *describe_changes(before, now))
    return ReferenceCheck(name, str(path), ok, words, refused=not ok)


WITHIN_BOUNDS = "within the bounds of `check`, and of different processors, on which Mitsuba's last bits depend"


def differ_by_processor(scene: Scene, before: Reference, now: Reference) -> bool:
    """Whether the processor explains all differences of two references of the same film, scene and channels.

    They have to name different processors, or one of them none, and the same versions and variant. Where only one
    answer is right, both are within the bounds that hold for ours, and pixels that miss have the same bits.
    """
    same = (*VERSIONS, VARIANT, SCENE_HASH)
    if before.about.get(PROCESSOR) == now.about.get(PROCESSOR):
        return False
    if any(before.about.get(key) != now.about.get(key) for key in same) or not comparable(before, now):
        return False
    ambiguous = np.isin([each.channels[CLASS_CHANNEL] for each in (before, now)], AMBIGUOUS_CLASSES).any(axis=0)
    for each in (before, now):
        _, geometry, light = compare_with_reference(scene, each)
        if not (ambiguous | np.where(each.channels["A"] != 0.0, light, geometry)).all():
            return False
    missed = ~ambiguous & (now.channels["A"] == 0.0)
    return all(
        before.channels[name][missed].tobytes() == now.channels[name][missed].tobytes()
        for name in now.channels
        if name != CLASS_CHANNEL
    )


def compare_with_reference(scene: Scene, before: Reference) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
    """(our channels, along the rays and on the geometry that Mitsuba was given; (h, w) bool: the geometry of the pixel
    is within the bounds that `validate` derives; (h, w) bool: its lighting is, too)."""
    rays = shared_rays(scene)
    view, window = cast_ours(scene, rays), film_window(scene)
    answer = answer_of_view(scene, view, AOVS)
    ours = answer.images
    assert ours is not None
    model = model_of(scene, view.packed, rays)
    o, d = rays.o.astype(np.float64), rays.d.astype(np.float64)
    t = view.nearest.t
    bounds = reference_bounds(model, view.nearest.prim, o, d, t)
    with np.errstate(invalid="ignore"):
        point = o + t[:, None] * d
    before_aovs = channels_to_aovs(before.channels)
    pixels = PixelPairs(ours, before_aovs, bounds, answer, np.linalg.norm(d, axis=1), point)
    geometry = compare(pixels, scene.checks).agrees
    light = geometry & lighting_agrees(scene, pixels, ShadingPoints(point, d, aov_rows(ours, "shape_id"), bounds.at))
    shape = window.height, window.width
    return aovs_to_channels(ours), geometry.reshape(shape), light.reshape(shape)


def lighting_agrees(scene: Scene, pixels: PixelPairs, hit: ShadingPoints) -> np.ndarray:
    """(n,) bool: both values of diffuse are within the error of all lights, whether in shadow or not."""
    rows = np.flatnonzero(pixels.both_hit)
    there = ShadingPoints(hit.p[rows], hit.d[rows], hit.shape[rows], hit.at.take(rows))
    ours, theirs = (values[rows] for values in pixels.pair("diffuse"))
    off, materials = COLOR_RTOL * np.abs(theirs), materials_of(scene)
    for each in scene.lights:
        if each.type != "ambient":
            off = off + light_contribution(materials, each, there, KU).error
    within = np.zeros(len(hit.p), bool)
    within[rows] = (np.abs(ours - theirs) <= off).all(axis=1)
    return within


def without_classes(found: Reference) -> Reference:
    """Mitsuba's own channels: a class depends on our caster as well."""
    return replace(found, channels={name: plane for name, plane in found.channels.items() if name != CLASS_CHANNEL})


MISSING, ALL = "missing", "all"
MODES = (MISSING, "changed", ALL)


class Proposal(NamedTuple):
    """The state of a scene's reference, and the reference to write."""

    name: str
    path: Path
    status: str  # missing, changed, stale, damaged, same, kept, failed
    write: bool
    details: tuple[str, ...] = ()
    fresh: Reference | None = None


def propose(
    scene: Scene, name: str, source: str, folder: Path, mode: str, render: Callable[[Scene, str], Reference | Crash]
) -> Proposal:
    """Render the scene unless nothing would be written, and compare with the stored reference. source: its file."""
    path = folder / f"{name}.exr"
    if mode == MISSING and path.exists():
        return Proposal(name, path, "kept", False, ("it exists; --update missing compares nothing",))
    fresh = render(scene, source)
    if isinstance(fresh, Crash):
        why = f"Mitsuba ended without an answer ({fresh.exit}): {fresh.headline}"
        return Proposal(name, path, "failed", False, (why,))
    if not path.exists():
        hit = int((fresh.channels["A"] != 0.0).sum())
        what = f"{hit} of {fresh.channels['A'].size} pixels hit, {len(fresh.channels)} channels"
        return Proposal(name, path, "missing", True, (what,), fresh)
    try:
        before = load_reference(path)
    except (UnusableReference, UnreadableExr) as error:
        return Proposal(name, path, "damaged", True, (str(error),), fresh)
    return _compare_proposal(scene, before, fresh, name, path, mode)


def _compare_proposal(scene: Scene, before: Reference, fresh: Reference, name: str, path: Path, mode: str) -> Proposal:
    found = tuple(describe_changes(before, fresh))
    if before.about.get(SCENE_HASH) != fresh.about[SCENE_HASH]:
        stale = "the scene has changed, no pixel has" if not found else "the scene has changed"
        return Proposal(name, path, "stale", True, (stale, *found), fresh)
    if not comparable(before, fresh) or channel_changes(before, fresh):
        if differ_by_processor(scene, before, fresh):
            found = (f"but for last bits; both are {WITHIN_BOUNDS}", *found)
            return Proposal(name, path, "same", mode == ALL, found, fresh)
        return Proposal(name, path, "changed", True, found, fresh)
    return Proposal(name, path, "same", mode == ALL and before.digest() != fresh.digest(), found, fresh)


def unused_references(folder: Path, names: set[str]) -> list[str]:
    """Names of files in the folder that belong to none of the scenes."""
    return sorted(path.name for path in folder.glob("*.exr") if path.stem not in names) if folder.is_dir() else []

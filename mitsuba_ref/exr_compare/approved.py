"""Approved images: EXR files of Mitsuba's answers with provenance and digest, their check, proposals of new ones."""

import hashlib
import json
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
from caster.image.exr import Exr, UnreadableExr, read_exr, write_exr
from caster.rendering.images import film_window
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import aov_rows, reference_bounds
from mitsuba_ref.error_model.lambert import ShadingPoints, light_contribution
from mitsuba_ref.error_model.tolerances import COLOR_RTOL, KU, Tolerances
from mitsuba_ref.exr_compare.exr_pair import LAYERS, SCENE_HASH, SCENE_JSON
from mitsuba_ref.exr_compare.two_files import compare_images
from mitsuba_ref.judge.classification import CLASS_CODE, Judge
from mitsuba_ref.judge.comparison import PixelPairs, compare, pair_images
from mitsuba_ref.judge.diffuse import materials_of
from mitsuba_ref.judge.verdict import EXCUSED, TIE
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT
from mitsuba_ref.reference.rendering import aovs_of, trace_reference
from mitsuba_ref.reference.shared_input import model_of, shared_rays
from mitsuba_ref.report import evidence
from mitsuba_ref.subjects.subject import answer_of_view, cast_ours

# The class of each pixel on approval: on edges and ties another answer is right as well.
CLASS_CHANNEL = "class.I"
AMBIGUOUS_CLASSES = tuple(CLASS_CODE[name] for name in (*EXCUSED, TIE))

# Without uv, since planes are replaced by finite shapes.
AOVS = ("hit", "depth", "normal", "shading_normal", "position", "diffuse", "shape_id")

PREFIX = "caster/reference/"
DIGEST, VARIANT, PROCESSOR = PREFIX + "sha256", PREFIX + "variant", PREFIX + "processor"
VERSIONS = ("caster/version", PREFIX + "mitsuba", PREFIX + "drjit", PREFIX + "libllvm")
EXACT = Tolerances(0.0, 0.0, 0.0, 0.0, 0.0, allow_empty=True, other_scene=True)
WITHIN_BOUNDS = "within the bounds of `check`, and of different processors, on which Mitsuba's last bits depend"


class UnusableImage(SceneError):  # noqa: N818 - the file is the subject
    """An approved image that does not hold for this scene; str() states why, and what to do."""

    exit_code = 1


# ---- files


def digest(image: Exr) -> str:
    """SHA-256 of every pixel and attribute except the digest itself."""
    words = sorted((key, value) for key, value in image.provenance.items() if key != DIGEST)
    sha256 = hashlib.sha256(json.dumps([words, image.data_window, image.display_window]).encode())
    for name, plane in sorted(image.channels.items()):
        sha256.update(f"\n{name} {plane.dtype} {plane.shape}\n".encode() + np.ascontiguousarray(plane).tobytes())
    return sha256.hexdigest()


def write_approved(path: Path, image: Exr) -> None:
    """Write an image with its digest; the same image gives the same bytes. Raises OutputError."""
    about = image.provenance | {DIGEST: digest(image)}
    write_exr(path, image.channels, about, data_window=image.data_window, display_window=image.display_window)


def load_approved(path: Path) -> Exr:
    """Read an approved image. Raises FileMissing, UnreadableExr, and UnusableImage where it was altered since."""
    image = read_exr(path)
    if DIGEST not in image.provenance:
        raise UnusableImage(f"no image of `mitsuba-ref approve`: it lacks {DIGEST}")
    if digest(image) != image.provenance[DIGEST]:
        raise UnusableImage("altered after it was approved: its digest is that of other contents")
    return image


def check_matches_scene(image: Exr, scene: Scene, variant: str | None) -> None:
    """Raise UnusableImage for another state of the scene, or another variant than required."""
    about = image.provenance
    if about.get(SCENE_HASH) != scene.sha256():
        raise UnusableImage(f"stale: {_scene_changes(about, scene)} since it was approved")
    if variant is not None and about.get(VARIANT) != variant:
        raise UnusableImage(f"rendered by {about.get(VARIANT)}, expected {variant}")


def _scene_changes(about: dict[str, str], scene: Scene) -> str:
    """The parts of a scene file that have changed; or mesh files, which the scene file only names."""
    try:
        before, now = json.loads(about[SCENE_JSON]), json.loads(scene.canonical_json())
    except (KeyError, ValueError):
        return "the scene has changed"
    parts = [key for key in sorted({*before, *now}) if before.get(key) != now.get(key)]
    if not parts:
        return "a mesh file of the scene has changed"
    return f"{', '.join(parts)} of the scene {'has' if len(parts) == 1 else 'have'} changed"


def render_fresh(
    scene: Scene, path: str, *, variant: str | None, command: str, timeout: float = DEFAULT_TIMEOUT
) -> Exr | Crash:
    """Mitsuba's image of a scene. path, command: recorded without folders, so that every machine with the same
    processor writes the same bytes; command: the one that renders it again. timeout: seconds for Mitsuba's answer."""
    rays = shared_rays(scene)
    view = cast_ours(scene, rays)
    model = model_of(scene, view.packed, rays)
    result = trace_reference(scene, model, rays, variant=variant, timeout=timeout)
    if isinstance(result, Crash):
        return result
    shape = film_window(scene).height, film_window(scene).width
    channels = _stored(aovs_to_channels(aovs_of(result, rays, shape, AOVS)))
    classes = Judge(scene, model, pair_images(scene, rays, answer_of_view(scene, view), result)).judge().classes
    channels[CLASS_CHANNEL] = classes.reshape(shape).astype(np.uint32)
    versions = result.answer.versions
    versions = versions | {"libllvm": Path(versions.get("libllvm", "none")).name, "command": command}
    about = provenance(scene, __version__, Path(path).name) | evidence.class_attributes()
    about |= {PREFIX + name: version for name, version in versions.items()}
    return Exr(channels, about, scene.film.window, (0, 0, scene.film.width, scene.film.height))


def _stored(channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The types that an EXR file holds."""
    return {name: plane if plane.dtype == np.uint32 else plane.astype(np.float32) for name, plane in channels.items()}


# ---- differences of two images of Mitsuba


def same_bits(before: Exr, now: Exr, where: Any = ...) -> bool:
    """Whether two images have the same film, channels, types and bits; classes, which depend on ours, apart."""
    planes = [
        {name: (plane.dtype, plane[where].tobytes()) for name, plane in each.channels.items() if name != CLASS_CHANNEL}
        for each in (before, now)
    ]
    return _film(before) == _film(now) and planes[0] == planes[1]


def _film(image: Exr) -> tuple[Any, ...]:
    return image.data_window, image.display_window


def changes(before: Exr, now: Exr) -> Iterator[str]:
    """Lines for a terminal: versions, processor, and what differs, to the bit."""
    for key in (*VERSIONS, VARIANT, PROCESSOR):
        old, new = before.provenance.get(key, "none"), now.provenance.get(key, "none")
        if old != new:
            yield f"{key.removeprefix(PREFIX).removeprefix('caster/')}: {old} -> {new}"
    result = compare_images(before, now, EXACT, names=("approved", "fresh"))
    if not result.groups:
        yield from (f"another film or other channels: {line.strip()}" for line in result.messages[1:-1])
    for group in result.groups:
        if group.worst is not None:
            count, at = group.differ + group.non_finite, f"({group.worst.x}, {group.worst.y})"
            yield f"{group.worst.channel}: {count} pixels differ, by at most {group.worst.error:.9g}, at {at}"


def differ_by_processor(scene: Scene, before: Exr, now: Exr) -> bool:
    """Whether the processor explains all differences of two images of the same film, scene and channels.

    They have to name different processors, or one of them none, and the same versions and variant. Where only one
    answer is right, both are within the bounds that hold for ours, and pixels that miss have the same bits.
    """
    same = (*VERSIONS, VARIANT, SCENE_HASH)
    abouts, images = (before.provenance, now.provenance), (before, now)
    if abouts[0].get(PROCESSOR) == abouts[1].get(PROCESSOR) or _film(before) != _film(now):
        return False
    if any(abouts[0].get(key) != abouts[1].get(key) for key in same) or before.channels.keys() != now.channels.keys():
        return False
    ambiguous = np.isin([each.channels[CLASS_CHANNEL] for each in images], AMBIGUOUS_CLASSES).any(axis=0)
    for each in images:
        _, geometry, light = within_bounds(scene, each)
        if not (ambiguous | np.where(each.channels["A"] != 0.0, light, geometry)).all():
            return False
    return same_bits(before, now, ~ambiguous & (now.channels["A"] == 0.0))


def within_bounds(scene: Scene, image: Exr) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
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
    pixels = PixelPairs(ours, channels_to_aovs(image.channels), bounds, answer, np.linalg.norm(d, axis=1), point)
    geometry = compare(pixels, scene.checks).agrees
    light = geometry & _lighting_agrees(scene, pixels, ShadingPoints(point, d, aov_rows(ours, "shape_id"), bounds.at))
    shape = window.height, window.width
    return aovs_to_channels(ours), geometry.reshape(shape), light.reshape(shape)


def _lighting_agrees(scene: Scene, pixels: PixelPairs, hit: ShadingPoints) -> np.ndarray:
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


# ---- check


@dataclass(frozen=True)
class ReferenceCheck:
    """Result of one scene. refused: the image has to be approved again, since it is missing, altered or stale, or
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
    scene: Scene, name: str, source: str, path: Path, variant: str | None, fresh: bool, max_pixels: int
) -> ReferenceCheck:
    """Compare our render, or with `fresh` Mitsuba's, with the approved image at path.

    source: the scene's file; variant: the required one, if any.
    """
    result = ReferenceCheck(name, str(path), False, ())
    try:
        approved = load_approved(path)
        check_matches_scene(approved, scene, variant)
    except FileMissing as error:
        text = str(error) if isinstance(error, UnreadableExr) else f"{path}: there is no approved image"
        return replace(result, words=(f"{text}; nothing was checked",), refused=True, missing=True)
    except UnusableImage as error:
        return replace(result, words=(f"{path}: {error}",), refused=True)
    try:
        ok, *words = _check_fresh(scene, source, approved) if fresh else _check_ours(scene, name, approved, max_pixels)
    except SceneError as error:
        return replace(result, words=(str(error),))
    return replace(result, ok=ok, words=tuple(words), refused=fresh and not ok and len(words) > 1)


def _check_ours(scene: Scene, name: str, approved: Exr, max_pixels: int) -> tuple[Any, ...]:
    """(passes, *lines): within the bounds of `validate` or `compare`, unless several answers were right on approval."""
    ambiguous = np.isin(approved.channels[CLASS_CHANNEL], AMBIGUOUS_CLASSES)
    hit = approved.channels["A"] != 0.0
    if hit.any() and not (hit & ~ambiguous).any():
        return False, f"nothing to compare: more than one answer is right at all {hit.sum()} pixels that are hit"
    images, geometry, light = within_bounds(scene, approved)
    shown = {CLASS_CHANNEL: approved.channels[CLASS_CHANNEL]}
    for channel, plane in _stored(images).items():
        passes = ambiguous | (light if channel in LAYERS["diffuse"] else geometry)
        shown[channel] = np.where(passes, approved.channels[channel], plane)
    tolerances = Tolerances(max_pixels=max_pixels, ignore=(CLASS_CHANNEL,))
    result = compare_images(approved._replace(channels=shown), approved, tolerances, names=(name, "the reference"))
    head, *rest = (line.removeprefix("PASS  ").removeprefix("FAIL  ").strip() for line in result.messages)
    if ambiguous.any():
        head += f"; {ambiguous.sum()} pixels with more than one right answer not compared"
    return result.ok, head, *rest


def _check_fresh(scene: Scene, source: str, approved: Exr) -> tuple[Any, ...]:
    """(passes, *lines): to the bit by the variant of the stored one; up to rounding, if by another processor."""
    variant = approved.provenance[VARIANT]
    fresh = render_fresh(scene, source, variant=variant, command="")
    if isinstance(fresh, Crash):
        return False, _crash_text(fresh)
    if same_bits(approved, fresh):
        return True, f"a fresh render by {variant} has the same bits"
    ok = differ_by_processor(scene, approved, fresh)
    why = f"; both are {WITHIN_BOUNDS}" if ok else ""
    return ok, f"a fresh render by {variant} has other bits{why}", *changes(approved, fresh)


def _crash_text(crash: Crash) -> str:
    return f"Mitsuba ended without an answer ({crash.exit}): {crash.headline}"


# ---- approve


class Proposal(NamedTuple):
    """The state of a scene's approved image, and the image to write."""

    name: str
    path: Path
    status: str  # missing, changed, stale, damaged, same, failed
    write: bool
    details: tuple[str, ...] = ()
    fresh: Exr | None = None


def propose(
    scene: Scene, name: str, source: str, folder: Path, render: Callable[[Scene, str], Exr | Crash]
) -> Proposal:
    """Render the scene and compare with the stored image. source: the scene's file."""
    path = folder / f"{name}.exr"
    fresh = render(scene, source)
    if isinstance(fresh, Crash):
        return Proposal(name, path, "failed", False, (_crash_text(fresh),))
    if not path.exists():
        hit = fresh.channels["A"] != 0.0
        what = f"{hit.sum()} of {hit.size} pixels hit, {len(fresh.channels)} channels"
        return Proposal(name, path, "missing", True, (what,), fresh)
    try:
        before = load_approved(path)
    except (UnusableImage, UnreadableExr) as error:
        return Proposal(name, path, "damaged", True, (str(error),), fresh)
    found = tuple(changes(before, fresh))
    same = same_bits(before, fresh)
    classes = same and np.array_equal(before.channels[CLASS_CHANNEL], fresh.channels[CLASS_CHANNEL])
    if before.provenance.get(SCENE_HASH) != fresh.provenance[SCENE_HASH]:
        stale = "the scene has changed, no pixel has" if same else "the scene has changed"
        return Proposal(name, path, "stale", True, (stale, *found), fresh)
    if classes:
        return Proposal(name, path, "same", False, found)
    if differ_by_processor(scene, before, fresh):
        return Proposal(name, path, "same", False, (f"but for last bits; both are {WITHIN_BOUNDS}", *found))
    return Proposal(name, path, "changed", True, found, fresh)


def unused_references(folder: Path, names: set[str]) -> list[str]:
    """Names of files in the folder that belong to none of the scenes."""
    return sorted(path.name for path in folder.glob("*.exr") if path.stem not in names) if folder.is_dir() else []

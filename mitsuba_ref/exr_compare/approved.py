"""Approved images: EXR files of Mitsuba's answers with provenance and digest, their check, proposals of new ones."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, computed_field

from caster import __version__
from caster.aovs import Aovs
from caster.description.errors import FileMissing, SceneError
from caster.image.channels import aovs_to_channels, channels_to_aovs, provenance
from caster.image.exr import Exr, UnreadableExr, read_exr, write_exr
from caster.scene.model import Scene
from caster.system.process import DIFFERENCES, FILE
from mitsuba_ref.error_model.bounds import aov_rows, reference_bounds
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.error_model.lambert import ShadingPoints, light_contribution
from mitsuba_ref.error_model.tolerances import COLOR_RTOL, KU, Tolerances
from mitsuba_ref.exr_compare.pixel_bounds import LAYERS, SCENE_HASH, SCENE_JSON
from mitsuba_ref.exr_compare.two_files import SIDES, FileComparison, compare_images
from mitsuba_ref.judge.classification import CLASS_CODE, judge_of
from mitsuba_ref.judge.comparison import PixelPairs, compare
from mitsuba_ref.judge.diffuse import materials_of
from mitsuba_ref.judge.verdict import EXCUSED, TIE
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.rendering import aovs_of
from mitsuba_ref.report import evidence
from mitsuba_ref.subjects.requests import request_answer
from mitsuba_ref.subjects.subject import OURS

# The class of each pixel on approval: on edges and ties another answer is right as well.
CLASS_CHANNEL = "class.I"
AMBIGUOUS_CLASSES = tuple(CLASS_CODE[name] for name in (*EXCUSED, TIE))

# Without uv, since planes are replaced by finite shapes.
AOVS = ("hit", "depth", "normal", "shading_normal", "position", "diffuse", "shape_id")

PREFIX = "caster/reference/"
DIGEST, VARIANT, PROCESSOR = PREFIX + "sha256", PREFIX + "variant", PREFIX + "processor"
REFERENCE = ("caster/version", *(PREFIX + each for each in ("mitsuba", "drjit", "libllvm")), VARIANT, PROCESSOR)
EXACT = Tolerances(0.0, 0.0, 0.0, 0.0, 0.0, other_scene=True)


class UnusableImage(SceneError):  # noqa: N818 - the file is the subject
    """An approved image that cannot be used for this scene; str() states why, and what to do."""

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


def check_matches_scene(image: Exr, scene: Scene) -> None:
    """Raise UnusableImage for another state of the scene, naming the changed parts of its file."""
    if image.provenance.get(SCENE_HASH) == scene.sha256():
        return
    try:
        before, now = json.loads(image.provenance[SCENE_JSON]), json.loads(scene.canonical_json())
        parts = [key for key in sorted({*before, *now}) if before.get(key) != now.get(key)] or ["a mesh file"]
    except (KeyError, ValueError):
        parts = ["some part"]
    raise UnusableImage(f"stale: {', '.join(parts)} of the scene changed since it was approved")


def render_fresh(scene: Scene, path: str, timeout: float) -> Exr | Crash:
    """Mitsuba's image of a scene. timeout: seconds for Mitsuba's answer.

    path: of the scene's file, recorded without its folder, so that every machine with the same processor writes the
    same bytes.
    """
    judge = judge_of(request_answer(OURS, scene), timeout=timeout, with_files=False)
    if isinstance(judge, Crash):
        return judge
    channels = _stored(aovs_to_channels(aovs_of(judge.result, judge.pair.rays, judge.pair.shape, AOVS)))
    channels[CLASS_CHANNEL] = judge.judge().classes.reshape(judge.pair.shape).astype(np.uint32)
    versions = judge.result.answer.versions
    versions = versions | {"libllvm": Path(versions.get("libllvm", "none")).name}
    about = provenance(scene, __version__, Path(path).name) | evidence.class_attributes()
    about |= {PREFIX + name: version for name, version in versions.items()}
    return Exr(channels, about, scene.film.window, (0, 0, scene.film.width, scene.film.height))


def _stored(channels: dict[str, Array]) -> dict[str, Array]:
    """The types that an EXR file holds."""
    return {name: plane if plane.dtype == np.uint32 else plane.astype(np.float32) for name, plane in channels.items()}


# ---- check: ours against an approved image


class ImageChecks(BaseModel):
    """Results of all scenes: the JSON of `mitsuba-ref check --json`. `ours` of each is the scene's name."""

    model_config = ConfigDict(frozen=True)

    scenes: tuple[FileComparison, ...]

    @computed_field  # type: ignore[prop-decorator]
    @property
    def ok(self) -> bool:
        """Whether every scene passes."""
        return all(scene.ok for scene in self.scenes)


def check_scene(scene: Scene, name: str, path: Path) -> FileComparison:
    """Compare our render with the approved image at path.

    The exit code is 4 where no image can be read; it and an image that is altered or stale leave `groups` empty.
    """
    code = DIFFERENCES
    try:
        approved = load_approved(path)
        check_matches_scene(approved, scene)
        return check_ours(scene, approved, (name, str(path)))
    except FileMissing as error:
        text = str(error) if isinstance(error, UnreadableExr) else f"{path}: there is no approved image"
        code, text = FILE, f"{text}; nothing was checked"
    except UnusableImage as error:
        text = f"{path}: {error}"
    return FileComparison(ours=name, reference=str(path), exit_code=code, reasons=(text,))


def check_ours(scene: Scene, approved: Exr, names: tuple[str, str]) -> FileComparison:
    """Compare our render with an approved image within the bounds of `validate` or `compare`.

    Pixels where several answers were right on approval are not compared.
    """
    if any(scene.textures):
        reason = "approved images have no uv to bound the colours of textures by; use validate"
        return FileComparison(ours=names[0], reference=names[1], reasons=(reason,))
    ambiguous = np.isin(approved.channels[CLASS_CHANNEL], AMBIGUOUS_CLASSES)
    hit = approved.channels["A"] != 0.0
    if hit.any() and not (hit & ~ambiguous).any():
        reason = f"nothing to compare: more than one answer is right at all {hit.sum()} pixels that are hit"
        return FileComparison(ours=names[0], reference=names[1], exit_code=DIFFERENCES, reasons=(reason,))
    ours, geometry, light = within_bounds(scene, approved)
    shown = {CLASS_CHANNEL: approved.channels[CLASS_CHANNEL]}
    images = Aovs({name: ours[name] for name in AOVS}, ours.hit)
    for channel, plane in _stored(aovs_to_channels(images)).items():
        agrees = light if channel in LAYERS["diffuse"] else geometry
        shown[channel] = np.where(ambiguous | agrees, approved.channels[channel], plane)
    left_out = f"{ambiguous.sum()} pixels with more than one right answer not compared"
    stated, tolerances = (left_out,) * bool(ambiguous.any()), Tolerances(ignore=(CLASS_CHANNEL,))
    return compare_images(approved._replace(channels=shown), approved, tolerances, names=names, stated=stated)


def within_bounds(scene: Scene, image: Exr) -> tuple[Aovs, Array, Array]:
    """Our AOVs, and whether the geometry and the light of each pixel (h, w) are within the bounds of `validate`."""
    response = request_answer(OURS, scene)
    answer, ours = response.answer, response.answer.images
    assert ours is not None and answer.prim is not None
    o, d = response.rays.o.astype(np.float64), response.rays.d.astype(np.float64)
    bounds = reference_bounds(response.model, answer.prim, o, d, answer.t)
    with np.errstate(invalid="ignore"):
        point = o + answer.t[:, None] * d
    pixels = PixelPairs(ours, channels_to_aovs(image.channels), bounds, answer, np.linalg.norm(d, axis=1), point)
    geometry = compare(pixels, scene.checks).agrees
    light = geometry & _lighting_agrees(scene, pixels, ShadingPoints(point, d, aov_rows(ours, "shape_id"), bounds.at))
    return ours, geometry.reshape(ours.hit.shape), light.reshape(ours.hit.shape)


def _lighting_agrees(scene: Scene, pixels: PixelPairs, hit: ShadingPoints) -> Array:
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


# ---- approve: a fresh image of Mitsuba against an approved one


class Proposal(NamedTuple):
    """The state of a scene's approved image, and the image to write."""

    name: str
    path: Path
    status: str  # missing, changed, stale, damaged, same, failed
    details: tuple[str, ...] = ()
    fresh: Exr | None = None  # to be written


def propose(scene: Scene, name: str, source: str, folder: Path, timeout: float) -> Proposal:
    """Render the scene with Mitsuba and compare with the stored image. source: the scene's file."""
    path = folder / f"{name}.exr"
    fresh = render_fresh(scene, source, timeout)
    if isinstance(fresh, Crash):
        return Proposal(name, path, "failed", (f"Mitsuba ended without an answer ({fresh.exit}): {fresh.headline}",))
    try:
        before = load_approved(path)
    except (UnusableImage, UnreadableExr) as error:
        return Proposal(name, path, "damaged", (str(error),), fresh)
    except FileMissing:
        hit = fresh.channels["A"] != 0.0
        what = f"{hit.sum()} of {hit.size} pixels hit, {len(fresh.channels)} channels"
        return Proposal(name, path, "missing", (what,), fresh)
    compared = compare_images(before, fresh, EXACT, names=("approved", "fresh"))
    about = {key: (before.provenance.get(key, "none"), fresh.provenance.get(key, "none")) for key in REFERENCE}
    changed = {key: values for key, values in about.items() if values[0] != values[1]}
    found = tuple(changes(changed, compared))
    try:
        check_matches_scene(before, scene)
    except UnusableImage as error:
        return Proposal(name, path, "stale", (str(error), *found), fresh)
    if compared.groups and not compared.differing_pixels:
        return Proposal(name, path, "same", found)
    if [*changed] == [PROCESSOR] and all(check_ours(scene, each, SIDES).ok for each in (before, fresh)):
        why = "but for last bits, which depend on the processor; both images pass `check`"
        return Proposal(name, path, "same", (why, *found))
    return Proposal(name, path, "changed", found, fresh)


def changes(about: Mapping[str, tuple[str, str]], compared: FileComparison) -> Iterator[str]:
    """Lines for a terminal: versions, processor, and the channels that differ."""
    yield from (f"{key.rpartition('/')[2]}: {old} -> {new}" for key, (old, new) in about.items())
    yield from (f"another film or other channels: {reason}" for reason in compared.reasons)
    for group in compared.groups:
        if group.worst is not None:
            count, at = group.differ + group.non_finite, f"({group.worst.x}, {group.worst.y})"
            yield f"{group.worst.channel}: {count} pixels differ, by at most {group.worst.error:.9g}, at {at}"

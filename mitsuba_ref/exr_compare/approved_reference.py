"""An approved reference EXR: Mitsuba's images of a scene with provenance and digest, and changes between two."""

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from caster import __version__
from caster.description.errors import SceneError
from caster.image.channels import aovs_to_channels, provenance
from caster.image.exr import Window, read_exr, write_exr
from caster.rendering.images import film_window
from caster.scene.model import Scene
from mitsuba_ref.judge.classification import CLASS_CODE, Judge
from mitsuba_ref.judge.comparison import pair_images
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
DIGEST = PREFIX + "sha256"
VARIANT = PREFIX + "variant"
VERSIONS = ("caster/version", PREFIX + "mitsuba", PREFIX + "drjit", PREFIX + "libllvm")
PROCESSOR = PREFIX + "processor"
SCENE_HASH = "caster/scene_sha256"
SCENE_JSON = "caster/scene_json"


class UnusableReference(SceneError):  # noqa: N818 - the file is the subject
    """A stored reference that does not hold for this scene; str() states why, and what to do."""

    exit_code = 1


@dataclass(frozen=True)
class Reference:
    """Channels by name (h, w), and string attributes."""

    channels: dict[str, np.ndarray]
    about: dict[str, str]
    window: Window
    film: Window

    def digest(self) -> str:
        """SHA-256 of every pixel and attribute except the digest itself."""
        sha256 = hashlib.sha256()
        words = {key: value for key, value in self.about.items() if key != DIGEST}
        sha256.update(json.dumps([sorted(words.items()), self.window, self.film]).encode())
        for name, plane in sorted(self.channels.items()):
            sha256.update(f"\n{name} {plane.dtype} {plane.shape}\n".encode() + np.ascontiguousarray(plane).tobytes())
        return sha256.hexdigest()

    def write(self, path: Path) -> None:
        """The same reference gives the same bytes. Raises OutputError."""
        about = self.about | {DIGEST: self.digest()}
        write_exr(path, self.channels, about, data_window=self.window, display_window=self.film)


def render_fresh(
    scene: Scene, path: str, *, variant: str | None, command: str, timeout: float = DEFAULT_TIMEOUT
) -> Reference | Crash:
    """A fresh one. path, command: recorded without folders, so that every machine with the same processor writes the
    same bytes; command: the one that renders it again. timeout: seconds for Mitsuba's answer."""
    rays = shared_rays(scene)
    view = cast_ours(scene, rays)
    model = model_of(scene, view.packed, rays)
    witness = trace_reference(scene, model, rays, variant=variant, timeout=timeout)
    if isinstance(witness, Crash):
        return witness
    shape = film_window(scene).height, film_window(scene).width
    images = aovs_of(witness, rays, shape, AOVS)
    classes = Judge(scene, model, pair_images(scene, rays, answer_of_view(scene, view), witness)).judge().classes
    versions = witness.answer.versions
    versions = versions | {"libllvm": Path(versions.get("libllvm", "none")).name, "command": command}
    about = provenance(scene, __version__, Path(path).name)
    about |= {PREFIX + name: version for name, version in versions.items()}
    about |= evidence.class_attributes()
    channels = {name: to_stored_type(plane) for name, plane in aovs_to_channels(images).items()}
    channels[CLASS_CHANNEL] = classes.reshape(shape).astype(np.uint32)
    return Reference(channels, about, scene.film.window, (0, 0, scene.film.width, scene.film.height))


def to_stored_type(plane: np.ndarray) -> np.ndarray:
    return plane if plane.dtype == np.uint32 else plane.astype(np.float32)


def load_reference(path: Path) -> Reference:
    """Read a reference. Raises FileMissing, UnreadableExr, and UnusableReference where it was altered since."""
    exr = read_exr(path)
    found = Reference(exr.channels, exr.provenance, exr.data_window, exr.display_window)
    if DIGEST not in exr.provenance:
        raise UnusableReference(f"no reference of `mitsuba-ref approve`: it lacks {DIGEST}")
    if found.digest() != exr.provenance[DIGEST]:
        raise UnusableReference("altered after it was approved: its digest is that of other contents")
    return found


def check_matches_scene(found: Reference, scene: Scene, variant: str | None) -> None:
    """Raise UnusableReference for another state of the scene, or another variant than required."""
    if found.about.get(SCENE_HASH) != scene.sha256():
        raise UnusableReference(f"stale: {describe_scene_changes(found, scene)} since it was approved")
    if variant is not None and found.about.get(VARIANT) != variant:
        raise UnusableReference(f"rendered by {found.about.get(VARIANT)}, expected {variant}")


def describe_scene_changes(found: Reference, scene: Scene) -> str:
    """The parts of a scene file that have changed; or mesh files, which the scene file only names."""
    try:
        before, now = json.loads(found.about[SCENE_JSON]), json.loads(scene.canonical_json())
    except (KeyError, ValueError):
        return "the scene has changed"
    parts: Sequence[str] = [key for key in sorted({*before, *now}) if before.get(key) != now.get(key)]
    if not parts:
        return "a mesh file of the scene has changed"
    return f"{', '.join(parts)} of the scene {'has' if len(parts) == 1 else 'have'} changed"


@dataclass(frozen=True)
class ChannelChange:
    """Difference of one channel, to the bit."""

    channel: str
    pixels: int  # with other bits
    largest: float  # difference; inf where only one is finite
    x: int
    y: int  # where that is, on the film


def channel_changes(before: Reference, now: Reference) -> tuple[ChannelChange, ...]:
    """Channels that differ, of two references of the same film window and channels."""
    found = []
    for name in sorted(now.channels):
        old, new = before.channels[name], now.channels[name]
        other = old.view(np.uint32) != new.view(np.uint32)
        if other.any():
            apart = difference(old, new, other)
            y, x = np.unravel_index(int(np.argmax(apart)), apart.shape)
            place = now.window[0] + int(x), now.window[1] + int(y)
            found.append(ChannelChange(name, int(other.sum()), float(apart[y, x]), *place))
    return tuple(found)


def difference(old: np.ndarray, new: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(h, w) absolute difference; 1 for ids, whose difference has no meaning."""
    if new.dtype == np.uint32:
        return other.astype(np.float64)
    with np.errstate(invalid="ignore"):
        apart = np.abs(new.astype(np.float64) - old.astype(np.float64))
    return np.where(other & np.isnan(apart), np.inf, np.where(other, apart, 0.0))


def comparable(before: Reference, now: Reference) -> bool:
    """Whether the two have the same window and the same channels of the same types."""
    kinds = [{name: plane.dtype for name, plane in each.channels.items()} for each in (before, now)]
    return before.window == now.window and before.film == now.film and kinds[0] == kinds[1]


def describe_changes(before: Reference, now: Reference) -> Iterator[str]:
    """For a terminal: versions, processor, hit mask, channels."""
    for key in (*VERSIONS, VARIANT, PROCESSOR):
        old, new = before.about.get(key, "none"), now.about.get(key, "none")
        if old != new:
            yield f"{key.removeprefix(PREFIX).removeprefix('caster/') or key}: {old} -> {new}"
    if not comparable(before, now):
        yield f"another film or other channels: window {before.window} -> {now.window}"
        return
    old_hit, new_hit = (each.channels["A"] != 0.0 for each in (before, now))
    if (old_hit != new_hit).any():
        gone, come = int((old_hit & ~new_hit).sum()), int((new_hit & ~old_hit).sum())
        yield f"hit mask: {gone} pixels no longer hit, {come} newly hit, of {int(new_hit.sum())}"
    for change in channel_changes(before, now):
        far = "by their ids" if change.channel.startswith("id.") else f"by at most {change.largest:.9g}"
        yield f"{change.channel}: {change.pixels} pixels differ, {far}, at ({change.x}, {change.y})"

"""One reference EXR: Mitsuba's images of a scene, with all that says where they come from, and a digest of it all."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from caster import __version__
from caster.channels import channels_of, provenance
from caster.exr import Window, read_exr, write_exr
from caster.rendering import film_window
from caster.scene import Scene
from caster.wording import SceneError
from mitsuba_ref import class_colors
from mitsuba_ref.jobs import Crash
from mitsuba_ref.judge import CODE, Judge
from mitsuba_ref.model import model_of
from mitsuba_ref.pair import our_view, pair_up
from mitsuba_ref.rays import share
from mitsuba_ref.reference import aovs_of, consult
from mitsuba_ref.verdict import EXCUSED, TIE

# Beside the images, what the judge said of each pixel on approval: on edges and ties another answer is right as well.
CLASS = "class.I"
EITHER_WAY = tuple(CODE[name] for name in (*EXCUSED, TIE))

AOVS = (
    "hit",
    "depth",
    "normal",
    "shading_normal",
    "position",
    "diffuse",
    "shape_id",
)  # no uv: planes have stand-ins

PREFIX = "caster/reference/"
DIGEST = PREFIX + "sha256"
VARIANT = PREFIX + "variant"
VERSIONS = ("caster/version", PREFIX + "mitsuba", PREFIX + "drjit")
SCENE_HASH = "caster/scene_sha256"
SCENE_JSON = "caster/scene_json"


class RefusedReference(SceneError):  # noqa: N818 - the file is the subject
    """A stored reference that says nothing about this scene any more; str() says why, and the way out."""

    exit_code = 1


@dataclass(frozen=True)
class Reference:
    """Channels by name (h, w), and string attributes."""

    channels: dict[str, np.ndarray]
    about: dict[str, str]
    window: Window
    film: Window

    def digest(self) -> str:
        """SHA-256 of every pixel and every word but the digest itself."""
        told = hashlib.sha256()
        words = {key: value for key, value in self.about.items() if key != DIGEST}
        told.update(json.dumps([sorted(words.items()), self.window, self.film]).encode())
        for name, plane in sorted(self.channels.items()):
            told.update(
                f"\n{name} {plane.dtype} {plane.shape}\n".encode() + np.ascontiguousarray(plane).tobytes()
            )
        return told.hexdigest()

    def write(self, path: Path) -> None:
        """The same reference gives the same bytes. Raises OutputError."""
        about = self.about | {DIGEST: self.digest()}
        write_exr(path, self.channels, about, data_window=self.window, display_window=self.film)


def rendered(scene: Scene, path: str, *, variant: str | None, command: str) -> Reference | Crash:
    """A fresh one. path, command: recorded without folders, so that every machine writes the same bytes."""
    rays = share(scene)
    view = our_view(scene, rays)
    model = model_of(scene, view.packed, rays)
    witness = consult(scene, model, rays, variant=variant)
    if isinstance(witness, Crash):
        return witness
    shape = film_window(scene).height, film_window(scene).width
    images = aovs_of(witness, rays, shape, AOVS)
    classes = Judge(scene, model, pair_up(scene, rays, view, witness)).judge().classes
    versions = witness.answer.versions
    versions = versions | {"libllvm": Path(versions.get("libllvm", "none")).name, "command": command}
    about = provenance(scene, __version__, Path(path).name)
    about |= {PREFIX + name: version for name, version in versions.items()}
    about |= class_colors.attributes()
    channels = {name: as_stored(plane) for name, plane in channels_of(images).items()}
    channels[CLASS] = classes.reshape(shape).astype(np.uint32)
    return Reference(channels, about, scene.film.window, (0, 0, scene.film.width, scene.film.height))


def as_stored(plane: np.ndarray) -> np.ndarray:
    return plane if plane.dtype == np.uint32 else plane.astype(np.float32)


def stored(path: Path) -> Reference:
    """What a file holds. Raises FileMissing, UnreadableExr, and RefusedReference where it was altered since."""
    exr = read_exr(path)
    found = Reference(exr.channels, exr.provenance, exr.data_window, exr.display_window)
    if DIGEST not in exr.provenance:
        raise RefusedReference(f"no reference of `mitsuba-ref approve`: it lacks {DIGEST}")
    if found.digest() != exr.provenance[DIGEST]:
        raise RefusedReference("altered after it was approved: its digest is that of other contents")
    return found


def check_fits(found: Reference, scene: Scene, variant: str | None) -> None:
    """Raise RefusedReference where it is of another state of the scene, or by another variant than demanded."""
    if found.about.get(SCENE_HASH) != scene.sha256():
        raise RefusedReference(f"stale: {what_changed(found, scene)} since it was approved")
    if variant is not None and found.about.get(VARIANT) != variant:
        raise RefusedReference(f"rendered by {found.about.get(VARIANT)}, expected {variant}")


def what_changed(found: Reference, scene: Scene) -> str:
    """The parts of a scene file that are not as they were; or mesh files, which the scene file only names."""
    try:
        before, now = json.loads(found.about[SCENE_JSON]), json.loads(scene.canonical_json())
    except (KeyError, ValueError):
        return "the scene has changed"
    parts: Sequence[str] = [key for key in sorted({*before, *now}) if before.get(key) != now.get(key)]
    if not parts:
        return "a mesh file of the scene has changed"
    return f"{', '.join(parts)} of the scene {'has' if len(parts) == 1 else 'have'} changed"

"""What `--candidate` names, and the question every candidate is asked."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from caster.description.errors import SceneError
from caster.scene.model import Scene
from mitsuba_ref.error_model.scene_model import SceneModel
from mitsuba_ref.reference.rays import SharedRays
from mitsuba_ref.subjects.answer import PRECISIONS, Answer

DEFAULT_SECONDS = 300.0  # that a command may take for one scene


@dataclass(frozen=True)
class CastRequest:
    """One scene, in the float32 numbers that Mitsuba traces, and its rays."""

    scene: Scene  # as described
    traced: Scene  # in the very numbers that are traced (mitsuba_ref/subjects/traced_scene.py)
    model: SceneModel
    rays: SharedRays
    folder: Path  # a temporary one that holds the meshes of `traced`


class Candidate(Protocol):
    """Somebody's ray caster."""

    @property
    def name(self) -> str:
        """As it was named by its user."""

    @property
    def reads_xml(self) -> bool:
        """Whether it sees the scene as plain Mitsuba does."""

    @property
    def takes_rays(self) -> bool:
        """Whether it is handed rays, and so can be asked about some of them."""

    def answer(self, question: CastRequest) -> Answer:
        """What it says of every ray. Raises NoAnswer."""


def parse_candidate(text: str, precision: str | None = None, seconds: float = DEFAULT_SECONDS) -> Candidate:
    """package.module:function, or a command with {xml} or {toml} and {exr}.

    Raises SceneError for what is neither, a function that cannot be imported, a program that is not there.
    """
    from mitsuba_ref.subjects.command import PLACEHOLDERS, command_of
    from mitsuba_ref.subjects.function import import_function, is_function

    if precision not in (None, *PRECISIONS):
        raise SceneError(f"--candidate-precision: expected {' or '.join(PRECISIONS)}, got {precision!r}")
    if is_function(text):
        return import_function(text, precision)
    if any(f"{{{name}}}" in text for name in PLACEHOLDERS):
        return command_of(text, precision, seconds)
    raise SceneError(
        f"--candidate {text!r}: expected package.module:function, or a command such as "
        "'my-renderer {xml} -o {exr}' ({toml} in place of {xml} for our scene file)"
    )

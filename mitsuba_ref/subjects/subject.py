"""The protocol of a subject, whoever is judged: it answers the rays of a scene with an `Answer`."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

from caster.scene.model import Scene
from mitsuba_ref.error_model.scene_model import SceneModel
from mitsuba_ref.reference.rays import SharedRays
from mitsuba_ref.subjects.answer import Answer
from mitsuba_ref.subjects.traced_scene import scene_as_traced


@dataclass(frozen=True)
class CastRequest:
    """One scene, its primitives in the float32 numbers that Mitsuba traces, and its rays."""

    scene: Scene  # as described
    model: SceneModel
    rays: SharedRays
    folder: Path  # a temporary one

    @cached_property
    def traced(self) -> Scene:
        """The scene described anew by the numbers that are traced; its meshes are files in `folder`."""
        return scene_as_traced(self.scene, self.model.packed, self.folder)


class Subject(Protocol):
    """A ray caster: ours, or a candidate in its place."""

    @property
    def name(self) -> str:
        """As its user named it; "" for ours."""

    @property
    def reads_xml(self) -> bool:
        """Whether it casts the same rays through the same scene as plain Mitsuba."""

    @property
    def takes_rays(self) -> bool:
        """Whether it casts the rays that it is given, so that it can be given some of them."""

    def answer(self, request: CastRequest) -> Answer:
        """The answer to every ray. Raises NoAnswer."""

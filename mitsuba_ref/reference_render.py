"""Mitsuba's pictures of a scene, without anything to compare them with."""

from collections.abc import Sequence

from caster.packing import pack
from caster.placing import as_float32
from caster.rendering import Aovs, film_window
from caster.scene import Scene
from mitsuba_ref.jobs import Crash
from mitsuba_ref.model import model_of
from mitsuba_ref.rays import share
from mitsuba_ref.reference import GIVEN, aovs_of, consult, wants_light
from mitsuba_ref.worker import DEFAULT_TIMEOUT


def render_reference(
    scene: Scene, aovs: Sequence[str] = GIVEN, *, variant: str | None = None, timeout: float = DEFAULT_TIMEOUT
) -> tuple[Aovs, dict[str, str]] | Crash:
    """(images as `caster.render` gives them, versions), or how Mitsuba ended."""
    rays = share(scene)
    model = model_of(scene, pack(scene, as_float32), rays)
    witness = consult(scene, model, rays, variant=variant, lights=wants_light(aovs), timeout=timeout)
    if isinstance(witness, Crash):
        return witness
    window = film_window(scene)
    return aovs_of(witness, rays, (window.height, window.width), aovs), witness.answer.versions

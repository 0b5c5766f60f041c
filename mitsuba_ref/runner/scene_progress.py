"""How far a validation has come: scenes, rays, time left."""

from collections.abc import Sequence

from caster.cli.progress import ProgressBar
from mitsuba_ref.runner.scene_runner import SceneEntry


def bar_for(entries: Sequence[SceneEntry]) -> ProgressBar:
    """Its measure is rays: scenes differ too much in size."""
    return ProgressBar("validating", sum(map(rays_of, entries)), "rays")


def count(bar: ProgressBar, entries: Sequence[SceneEntry], done: int) -> None:
    """The scene number `done`, counted from 1, is done."""
    bar.add(rays_of(entries[done - 1]), f"{done} of {len(entries)} scenes")


def rays_of(entry: SceneEntry) -> int:
    x0, y0, x1, y1 = entry.scene.film.window
    return (x1 - x0) * (y1 - y0)

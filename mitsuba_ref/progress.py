"""How far a validation has come: scenes, rays, time left."""

from collections.abc import Sequence

from caster.progress_bar import Bar
from mitsuba_ref.campaign import Entry


def bar_for(entries: Sequence[Entry]) -> Bar:
    """Its measure is rays: scenes differ too much in size."""
    return Bar("validating", sum(map(rays_of, entries)), "rays")


def count(bar: Bar, entries: Sequence[Entry], done: int) -> None:
    """The scene number `done`, counted from 1, is done."""
    bar.add(rays_of(entries[done - 1]), f"{done} of {len(entries)} scenes")


def rays_of(entry: Entry) -> int:
    x0, y0, x1, y1 = entry.scene.film.window
    return (x1 - x0) * (y1 - y0)

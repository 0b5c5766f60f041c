"""A finding -> the smallest scene with one ray, or one pixel, that is found wrong in the same way."""

from collections.abc import Callable
from typing import Any

import numpy as np

from caster.packing import count, pack
from caster.rendering import camera_rays
from caster.wording import SceneError
from mitsuba_ref.fuzz.aims import Shots
from mitsuba_ref.fuzz.as_packed import as_packed, moved
from mitsuba_ref.fuzz.case import Case, findings_of
from mitsuba_ref.fuzz.finding import Finding
from mitsuba_ref.fuzz.shrink import Budget, Data, Shrinker, fewer_fields, fewer_shapes, rounder_numbers

Judge = Callable[[Case], list[Finding]]
MOST_FACES = 2000  # of a mesh that is taken apart


def smallest(case: Case, finding: Finding, judge: Judge = findings_of, budget: Budget | None = None) -> Case:
    """The case made small. A pixel's finding becomes that of a ray cast for itself, if that shows it, too."""

    def fails(data: Data) -> bool:
        return finding.way in ways_of(Case.of(data), judge)

    start = start_of(case, finding, judge)
    shrinker = Shrinker(start.to_data(), fails, budget or Budget())
    passes = [written_anew, fewer_shapes, fewer_fields, to_the_origin, rounder_numbers]
    return Case.of(shrinker.run(passes))


def ways_of(case: Case, judge: Judge) -> set[tuple[str, str]]:
    return {finding.way for finding in judge(case)}


def start_of(case: Case, finding: Finding, judge: Judge) -> Case:
    """The case with the finding's one ray, or with one pixel, if that is enough."""
    rays = [] if finding.ray is None else [finding.ray]
    pixel = finding.pixel
    if pixel is not None:
        x, y = pixel
        cropped = case._replace(film={**case.film, "crop": [x, y, x + 1, y + 1]})
        rays += [] if finding.ray is not None else ray_of(cropped)
    for ray in rays:
        alone = case._replace(ray=ray)
        if finding.way in ways_of(alone, judge):
            return alone
    if pixel is not None and finding.way in ways_of(cropped, judge):
        return cropped
    return case


def ray_of(cropped: Case) -> list[Shots]:
    rays = camera_rays(cropped.scene())
    return [Shots(rays.o, rays.d, rays.t_min, rays.t_max)]


def written_anew(shrinker: Shrinker) -> bool:
    """Each shape by what it packs to: triangles for a mesh, one matrix for a transform."""
    changed = False
    for i in range(len(shrinker.data["shape"]) - 1, -1, -1):
        shapes = shrinker.data["shape"]
        plain = _plain(shrinker.data, i)
        if plain and plain != [shapes[i]]:
            changed |= shrinker.accepts({**shrinker.data, "shape": [*shapes[:i], *plain, *shapes[i + 1 :]]})
    return changed


def _plain(data: Data, i: int) -> list[dict[str, Any]]:
    alone = Case.of({**data, "shape": [data["shape"][i]]})
    try:
        part = pack(alone.scene()).parts[0]
        return as_packed(part) if count(part) <= MOST_FACES else []
    except (SceneError, LookupError):
        return []


def to_the_origin(shrinker: Shrinker) -> bool:
    """Everything moved so that the ray starts in 0, or a corner or centre lies there."""
    ray = shrinker.data.get("ray")
    if ray is None or not any(ray["o"]):
        return False
    by = -np.array(ray["o"])
    shapes = [moved(shape, by) for shape in shrinker.data["shape"]]
    if None in shapes:
        return False
    return shrinker.accepts({**shrinker.data, "shape": shapes, "ray": {**ray, "o": [0.0, 0.0, 0.0]}})

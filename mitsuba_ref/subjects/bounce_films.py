"""The secondary rays of a scene, bounce after bounce, laid out as films: what `--bounces` judges."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from caster.rendering.bounces import RAY_KINDS, Bounce, bounces
from caster.scene.model import MAX_FILM_SIDE, Scene
from mitsuba_ref.reference.shared_input import SharedRays, pixel_of, shared_rays
from mitsuba_ref.subjects.ray_files import RayList, lay_out
from mitsuba_ref.subjects.subject import cast_ours

# A bounce is shown as views, one below the other, if these have at most so many pixels, or so many for each ray.
LARGEST_VIEWS, VIEW_PIXELS_PER_RAY = 1 << 16, 4


class BounceFilm(NamedTuple):
    """The rays of one bounce as a film."""

    scene: Scene  # with that film
    rays: SharedRays
    bounce: Bounce
    row: np.ndarray  # (n,) pixel of the film for each ray of the bounce
    view: Scene  # with the film of the camera
    has_views: bool  # else rays follow each other, whatever their pixels

    def pixel(self, x: int, y: int) -> tuple[int, int]:
        """The camera's pixel from which the ray at a pixel of the film comes."""
        ray = np.flatnonzero(self.row == y * self.scene.film.width + x)
        return pixel_of(self.view, int(self.bounce.rays.pixel[ray[0]])) if len(ray) else (x, y)

    @property
    def place(self) -> tuple[int, int, int]:
        """Column and row of the camera's first pixel, and how many rows of pixels each view has; 0: no views."""
        x0, y0, _, y1 = self.view.film.window
        return x0, y0, (y1 - y0) * self.has_views

    def by_kind(self, film: np.ndarray) -> dict[str, np.ndarray]:
        """The values of a film, (pixels,), at the rays of each kind that occurs."""
        kinds = self.bounce.rays.kind
        return {RAY_KINDS[kind]: film[self.row[kinds == kind]] for kind in np.unique(kinds)}


def bounce_films(scene: Scene, depth: int) -> Iterator[BounceFilm]:
    """The films of bounces 1 to `depth`; fewer where no rays are left.

    Rays of the same path, such as those reflected once and then refracted, make up a view of the camera's film. Views
    are one below the other, unless they are mostly empty.
    """
    x0, y0, x1, y1 = scene.film.window
    width, height = x1 - x0, y1 - y0
    path = np.zeros(width * height, np.int64)
    for bounce in bounces(cast_ours(scene, shared_rays(scene)), depth):
        rays = bounce.rays
        path = _paths(path[rays.parent], rays.parent, rays.kind)
        views = int(path.max()) + 1
        pixels = views * width * height
        has_views = pixels <= max(LARGEST_VIEWS, VIEW_PIXELS_PER_RAY * len(path)) and views * height <= MAX_FILM_SIDE
        row = path * width * height + rays.pixel if has_views else np.arange(len(path))
        listed = np.column_stack(rays[:4])
        rows = np.zeros((pixels if has_views else len(path), listed.shape[1]))
        rows[:, 5], rows[:, 7] = 1.0, -1.0  # no ray
        rows[row] = listed
        film, shared = lay_out(scene, RayList(rows, width if has_views else 0))
        yield BounceFilm(film, shared, bounce, row, scene, has_views)


def bounce_film(scene: Scene, number: int) -> BounceFilm | None:
    """The film of one bounce; None where no rays are left."""
    return next((film for film in bounce_films(scene, number) if film.bounce.number == number), None)


def _paths(of_parent: np.ndarray, parent: np.ndarray, kind: np.ndarray) -> np.ndarray:
    """(n,) number of each ray's path: of its parent's, its kind, and its place among the parent's rays of that kind."""
    order = np.lexsort((kind, parent))
    same = np.r_[False, (np.diff(parent[order]) == 0) & (np.diff(kind[order].astype(int)) == 0)]
    first = np.maximum.accumulate(np.where(same, 0, np.arange(len(order))))
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order)) - first
    key = (of_parent * len(RAY_KINDS) + kind) * (place.max(initial=0) + 1) + place
    return np.unique(key, return_inverse=True)[1]

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

    Each view has the camera's film and one ray of each pixel at most: the first one, the second one, and so on. Views
    are one below the other, unless they are mostly empty.
    """
    x0, y0, x1, y1 = scene.film.window
    width, height = x1 - x0, y1 - y0
    for bounce in bounces(cast_ours(scene, shared_rays(scene)), depth):
        rays = bounce.rays
        view = _places(rays.pixel)
        rows, pixels = (int(view.max()) + 1) * height, (int(view.max()) + 1) * height * width
        has_views = pixels <= max(LARGEST_VIEWS, VIEW_PIXELS_PER_RAY * len(view)) and rows <= MAX_FILM_SIDE
        row = view * width * height + rays.pixel if has_views else np.arange(len(view))
        listed = np.zeros((pixels if has_views else len(view), 8))
        listed[:, 5], listed[:, 7] = 1.0, -1.0  # no ray
        listed[row] = np.column_stack(rays[:4])
        film, shared = lay_out(scene, RayList(listed, width if has_views else 0))
        yield BounceFilm(film, shared, bounce, row, scene, has_views)


def bounce_film(scene: Scene, number: int) -> BounceFilm | None:
    """The film of one bounce; None where no rays are left."""
    return next((film for film in bounce_films(scene, number) if film.bounce.number == number), None)


def _places(pixel: np.ndarray) -> np.ndarray:
    """(n,) how many rays before each one come from the same pixel."""
    order = np.argsort(pixel, kind="stable")
    place = np.empty(len(pixel), np.int64)
    place[order] = np.arange(len(pixel)) - np.searchsorted(pixel[order], pixel[order])
    return place

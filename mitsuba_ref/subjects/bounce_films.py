"""The secondary rays of a scene, bounce after bounce, laid out as films: what `--bounces` judges."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from caster.rendering.bounces import Bounce, bounces
from caster.scene.model import MAX_FILM_SIDE, Scene
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.reference.shared_input import SharedRays, pixel_of, shared_rays
from mitsuba_ref.subjects.ray_files import RayList, lay_out
from mitsuba_ref.subjects.subject import cast_ours


class BounceFilm(NamedTuple):
    """The rays of one bounce as a film."""

    scene: Scene  # with that film
    rays: SharedRays
    bounce: Bounce
    row: Array  # (n,) pixel of the film for each ray of the bounce
    view: Scene  # with the film of the camera

    def pixel(self, x: int, y: int) -> tuple[int, int]:
        """The camera's pixel from which the ray at a pixel of the film comes."""
        ray = np.flatnonzero(self.row == y * self.scene.film.width + x)
        return pixel_of(self.view, int(self.bounce.rays.pixel[ray[0]])) if len(ray) else (x, y)

    @property
    def place(self) -> tuple[int, int, int]:
        """Column and row of the camera's first pixel, and how many rows of pixels its view has."""
        x0, y0, x1, y1 = self.view.film.window
        return x0, y0, y1 - y0 if self.scene.film.width == x1 - x0 else 0


def bounce_films(scene: Scene, depth: int) -> Iterator[BounceFilm]:
    """The films of bounces 1 to `depth`; fewer where no rays are left.

    The first ray of each pixel is at that pixel of the camera's view, and the others follow below it, if a film can be
    so high.
    """
    x0, y0, x1, y1 = scene.film.window
    width, count = x1 - x0, (x1 - x0) * (y1 - y0)
    for bounce in bounces(cast_ours(scene, shared_rays(scene)), depth):
        rays = bounce.rays
        first = np.unique(rays.pixel, return_index=True)[1]
        others = np.setdiff1d(np.arange(len(rays.pixel)), first)
        row = rays.pixel.astype(np.int64)
        row[others] = count + np.arange(len(others))
        fits = count + len(others) <= width * MAX_FILM_SIDE
        listed = np.zeros((count + len(others), 8))
        listed[:, 5], listed[:, 7] = 1.0, -1.0  # no ray
        listed[row] = np.column_stack(rays[:4])
        film, shared = lay_out(scene, RayList(listed, width if fits else 0))
        yield BounceFilm(film, shared, bounce, row, scene)

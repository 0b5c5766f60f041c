"""Scenes whose reference is a user's own Mitsuba file."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import PrivateAttr

from caster.description.errors import SceneError
from caster.scene.model import Film, Scene
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.reference.messages import Coverage, OpenRequest, OpenResponse


@dataclass(frozen=True, eq=False)
class Original:
    """The file that is the reference of a scene, as opened."""

    request: OpenRequest  # with the digest of its files
    opened: OpenResponse
    film: Film
    start: Array  # (pixels,) float64, distance from the eye to o; 0 where the caster has no such camera
    keys: tuple[str, ...]  # by which Mitsuba's answers name the scene's shapes
    condition: Array  # (shapes,) as in error_model.scene_model.InstancedModel
    exact_camera: bool  # whether that has the sensor's rays, up to rounding
    coverage: Coverage

    def rows(self, film: Film) -> Array:
        """(n,) numbers of the rays in the window of a film of the same size."""
        x0, y0, x1, y1 = self.film.window
        a0, b0, a1, b1 = film.window
        size = self.film.width, self.film.height
        if (film.width, film.height) != size or a0 < x0 or b0 < y0 or a1 > x1 or b1 > y1:
            raise SceneError(f"film: expected a window of {self.film.window} of {size}, as the file was opened")
        numbers = np.arange(len(self.start)).reshape(y1 - y0, x1 - x0)
        return numbers[b0 - y0 : b1 - y0, a0 - x0 : a1 - x0].ravel()


class MitsubaScene(Scene):
    """A scene of the shapes that Mitsuba holds of a file, which is its reference."""

    _original: Original | None = PrivateAttr(None)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> "MitsubaScene":
        """A copy about the same file."""
        copy = super().model_copy(update=update, deep=deep)
        copy._original = self._original
        return copy

    def sha256(self) -> str:
        """A hash of the contents of the file and all files that it names, and of how it was opened."""
        assert self._original is not None  # open_scene sets it
        return self._original.request.digest


def original_of(scene: Scene) -> Original | None:
    """The file that is the scene's reference; None where the scene itself is exported."""
    return scene._original if isinstance(scene, MitsubaScene) else None

"""Drivers of the timed ray casters: their task, what they share, ours and a candidate (mitsuba_drivers.py: Mitsuba).

A task is a folder with the scene in every form that some ray caster reads, and what to compute. The compiler of ours is
not loaded where Mitsuba runs.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mitsuba_ref.error_model.intersections import Array

if TYPE_CHECKING:
    import caster

# Workloads: an image of some AOVs; t and normal along given rays.
FILM, NEAREST = "film", "nearest"
AOVS = ("depth", "normal")  # of a film, unless others are asked for

SCENE_FILE, RAYS_FILE = "scene.pickle", "rays.npz"  # files of a folder
ROBUST, DEFAULT = "robust", "default"  # folders within: a scene for Mitsuba in Embree's two modes
FIRST_RAY = (np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))  # for trees that are built on the first ray
WARM_UP_SIDE = 8  # pixels: enough to make everything that is made before rays are cast


@dataclass(frozen=True)
class Work:
    """One caster's job."""

    folder: str
    workload: str
    driver: str  # "module:class" of the caster, in mitsuba_ref.bench
    aovs: tuple[str, ...] = AOVS
    options: Mapping[str, Any] = field(default_factory=dict)  # its own

    def rays(self, rows: Sequence[int] | slice) -> tuple[Array, Array]:
        """o, d (n, 3) float32 of some of the scene's rays."""
        with np.load(Path(self.folder) / RAYS_FILE) as file:
            return file["o"][rows], file["d"][rows]


class CannotRun(Exception):  # noqa: N818 - the reason of an empty row, not an error
    """The reason of a row without numbers."""


class Driver:
    """Drives one ray caster in a process of its own: a subclass defines build, prepare and trace.

    It is created with its Work. A method raises CannotRun where the caster has no such feature.
    """

    precision = "float32"  # of its arithmetic

    def __init__(self, work: Work) -> None:
        self.work = work

    def build(self, size: int) -> None:
        """Build everything that is needed to cast size x size rays. Called once, and timed."""
        raise NotImplementedError

    def prepare(self, o: Array, d: Array) -> Any:
        """Convert rays (n, 3) float32 to the caster's own form. Not timed."""
        raise NotImplementedError

    def trace(self, rays: Any) -> Any:
        """Cast rays; returns an array of t, inf on a miss."""
        raise NotImplementedError

    def take_rays(self, size: int) -> None:
        """Prepare the rays in the folder: all of them, or size * size of them, spread evenly."""
        o, d = self.work.rays(slice(None))
        some = np.linspace(0, len(o) - 1, min(len(o), size * size)).astype(int)
        self.count = len(some)
        self.rays = self.prepare(o[some], d[some])

    def cast(self) -> int:
        """Cast all rays once; returns their number."""
        self.trace(self.rays)
        return self.count

    def answer(self, o: Array, d: Array) -> Array:
        """(n,) float64 t of rays (n, 3) float32, inf on a miss."""
        return np.array(self.trace(self.prepare(o, d)), np.float64)

    def scene_of_size(self, size: int) -> caster.Scene:
        scene: caster.Scene = pickle.loads((Path(self.work.folder) / SCENE_FILE).read_bytes())
        return scene.with_film(width=size, height=size)


class Ours(Driver):
    """Our caster."""

    precision = "float64"

    def build(self, size: int) -> None:
        import caster

        self.caster, self.scene = caster, self.scene_of_size(size)
        if self.work.workload == FILM:
            self._render(self.scene.with_film(width=WARM_UP_SIDE, height=WARM_UP_SIDE))
        else:
            self.trace(self.prepare(*FIRST_RAY))

    def prepare(self, o: Array, d: Array) -> Any:
        return o.astype(np.float64), d.astype(np.float64)

    def trace(self, rays: Any) -> Any:
        hits = self.caster.cast(self.scene, *rays)
        hits.normal  # noqa: B018 - computed on access
        return hits.t

    def cast(self) -> int:
        if self.work.workload != FILM:
            return super().cast()
        self._render(self.scene)
        return int(self.scene.film.width * self.scene.film.height)

    def _render(self, scene: caster.Scene) -> None:
        self.caster.render(scene, self.work.aovs, dtype=np.float32)


class Candidate(Driver):
    """A candidate that takes rays. options: those of `parse_candidate`, and the folder to run it in."""

    def __init__(self, work: Work) -> None:
        from mitsuba_ref.subjects.requests import parse_candidate

        super().__init__(work)
        options = work.options
        os.chdir(options["folder"])
        self.subject = parse_candidate(options["text"], options["precision"], served=options["served"])

    def build(self, size: int) -> None:
        """Prepare the scene in float32 numbers, and cast one ray."""
        from mitsuba_ref.reference.shared_input import model_of
        from mitsuba_ref.subjects.subject import CastRequest

        scene, one = self.scene_of_size(size), self.prepare(*FIRST_RAY)
        model = model_of(scene, one)
        self.request = CastRequest(scene, model, one, Path(self.work.folder) / f"candidate-{size}")
        self.trace(one)

    def prepare(self, o: Array, d: Array) -> Any:
        from mitsuba_ref.reference.shared_input import endless_rays

        return endless_rays(o, d)

    def trace(self, rays: Any) -> Any:
        from mitsuba_ref.subjects.subject import NoAnswer

        try:
            answer = self.subject.answer(self.request.with_rays(rays))
        except NoAnswer as error:
            raise CannotRun(str(error)) from error
        self.precision = answer.precision
        return answer.t

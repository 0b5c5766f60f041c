"""Our caster through its public names, and the copying of its images as a lower bound of time."""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mitsuba_ref.bench.work import ANY, FIRST_RAY, NEAREST, SCENE_FILE, SHADOW_END, Work, blocked, given_rays

if TYPE_CHECKING:
    import caster

AOVS = ("depth", "normal")
CHANNELS = 4  # of these: depth and the three of a normal
BYTES_PER_CHANNEL = 4  # float32, as EXR stores them and the other contestants return them
WARM_UP_SIDE = 8  # pixels: enough to make everything that is made before rays are cast


class Ours:
    """options: culling, aovs, shadows; by default the planned culling, depth and normal, with shadows."""

    def __init__(self, work: Work) -> None:
        self.work = work
        self.aovs = tuple(work.options.get("aovs", AOVS))
        self.file = Path(work.folder) / SCENE_FILE

    def build(self, size: int) -> None:
        """A new scene, and an image of a few pixels; mesh files are read before."""
        import caster

        self.caster = caster
        scene: caster.Scene = pickle.loads(self.file.read_bytes())
        shadows = caster.Shading(shadows=self.work.options.get("shadows", True))
        self.scene = scene.with_film(width=size, height=size).model_copy(update={"shading": shadows})
        if self.work.workload in (NEAREST, ANY):
            self._cast(*FIRST_RAY)
        else:
            self._render(self.scene.with_film(width=WARM_UP_SIDE, height=WARM_UP_SIDE))

    def take_rays(self) -> None:
        if self.work.workload in (NEAREST, ANY):
            o, d = given_rays(self.work.folder, self.scene.film.width)
            self.o, self.d = o.astype(np.float64), d.astype(np.float64)

    def cast(self) -> int:
        if self.work.workload in (NEAREST, ANY):
            self._cast(self.o, self.d)
            return len(self.o)
        self._render(self.scene)
        return self.scene.film.width * self.scene.film.height

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        if self.work.workload == ANY:
            return blocked(self.caster.occluded(self.scene, o, d, SHADOW_END))
        return self.caster.cast(self.scene, o, d).t

    def _render(self, scene: caster.Scene) -> None:
        self.caster.render(
            scene,
            self.aovs,
            threads=self.work.threads,
            culling=self.work.options.get("culling"),
            dtype=np.float32,
        )

    def _cast(self, o: np.ndarray, d: np.ndarray) -> None:
        if self.work.workload == ANY:
            self.caster.occluded(self.scene, o, d, SHADOW_END)
        else:
            hits = self.caster.cast(self.scene, o, d)
            hits.normal  # noqa: B018 - computed on access


class Copying:
    """Copies arrays as large as the images of depth and normal: the least time that writing them takes."""

    def __init__(self, work: Work) -> None:
        self.threads = work.threads
        self.pool = ThreadPoolExecutor(work.threads)

    def build(self, size: int) -> None:
        self.count = size * size
        self.source = np.ones(CHANNELS * self.count * BYTES_PER_CHANNEL, np.uint8)
        self.target = np.zeros_like(self.source)

    def take_rays(self) -> None:
        """There are none."""

    def cast(self) -> int:
        pairs = zip(*(np.array_split(a, self.threads) for a in (self.target, self.source)), strict=True)
        list(self.pool.map(lambda pair: np.copyto(*pair), pairs))
        return self.count

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        """It has no t to be wrong about."""
        return np.full(len(o), np.nan)

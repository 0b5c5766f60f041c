"""Our caster, through its public names."""

import pickle
from pathlib import Path

import numpy as np

import caster
from mitsuba_ref.bench.work import ANY, FIRST_RAY, NEAREST, SCENE_FILE, SHADOW_END, Work, blocked, given_rays

AOVS = ("depth", "normal")
FEW = 8  # pixels a side: enough to make everything that is made before rays are cast


class Ours:
    """options: culling, aovs, shadows; without them what `render` does unasked, depth and normal, shadows."""

    def __init__(self, work: Work) -> None:
        self.work = work
        self.aovs = tuple(work.options.get("aovs", AOVS))
        self.file = Path(work.folder) / SCENE_FILE

    def build(self, size: int) -> None:
        """A scene of which nothing is known yet, and a picture of a few pixels; of meshes, the file is read before."""
        scene: caster.Scene = pickle.loads(self.file.read_bytes())
        shadows = caster.Shading(shadows=self.work.options.get("shadows", True))
        self.scene = scene.with_film(width=size, height=size).model_copy(update={"shading": shadows})
        if self.work.asks in (NEAREST, ANY):
            self._shoot(*FIRST_RAY)
        else:
            self._picture(self.scene.with_film(width=FEW, height=FEW))

    def take_rays(self) -> None:
        if self.work.asks in (NEAREST, ANY):
            o, d = given_rays(self.work.folder, self.scene.film.width)
            self.o, self.d = o.astype(np.float64), d.astype(np.float64)

    def cast(self) -> int:
        if self.work.asks in (NEAREST, ANY):
            self._shoot(self.o, self.d)
            return len(self.o)
        self._picture(self.scene)
        return self.scene.film.width * self.scene.film.height

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        if self.work.asks == ANY:
            return blocked(caster.occluded(self.scene, o, d, SHADOW_END))
        return caster.cast(self.scene, o, d).t

    def _picture(self, scene: caster.Scene) -> None:
        caster.render(
            scene,
            self.aovs,
            threads=self.work.threads,
            culling=self.work.options.get("culling"),
            dtype=np.float32,
        )

    def _shoot(self, o: np.ndarray, d: np.ndarray) -> None:
        if self.work.asks == ANY:
            caster.occluded(self.scene, o, d, SHADOW_END)
        else:
            hits = caster.cast(self.scene, o, d)
            hits.normal  # noqa: B018 - they are worked out when they are asked for


BYTES = 4  # of a number in our images: float32, as EXR stores them and everybody else gives them

"""Mitsuba's scalar variant along rays that are handed over, one by one: it has no other way in from Python."""

from pathlib import Path

import numpy as np

from mitsuba_ref.bench.entries.mitsuba_aov import one_by_one
from mitsuba_ref.bench.work import ANY, SHADOW_END, Work, blocked, given_rays
from mitsuba_ref.reference.mitsuba_process import mi

VARIANT = "scalar_rgb"


class Loop:
    """options: mode, a folder with the XML."""

    def __init__(self, work: Work) -> None:
        mi.set_variant(VARIANT)
        mi.set_log_level(mi.LogLevel.Error)
        self.work = work
        self.xml = Path(work.folder) / work.options["mode"] / "scene.xml"

    def build(self, size: int) -> None:
        self.scene = mi.load_file(str(self.xml), optimize=False)
        self.size = size

    def take_rays(self) -> None:
        o, d = given_rays(self.work.folder, self.size)
        end = SHADOW_END if self.work.asks == ANY else np.inf
        pairs = zip(o.tolist(), d.tolist(), strict=True)
        self.rays = [mi.Ray3f(a, b, end, 0.0, []) for a, b in pairs]

    def cast(self) -> int:
        if self.work.asks == ANY:
            np.array([self.scene.ray_test(ray) for ray in self.rays])
            return len(self.rays)
        t, n = np.empty(len(self.rays), np.float32), np.empty((len(self.rays), 3), np.float32)
        for i, ray in enumerate(self.rays):
            si = self.scene.ray_intersect(ray)
            t[i], n[i] = si.t, si.n
        return len(self.rays)

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        if self.work.asks != ANY:
            return one_by_one(self.scene, o, d)
        pairs = zip(o.tolist(), d.tolist(), strict=True)
        return blocked(np.array([self.scene.ray_test(mi.Ray3f(a, b, SHADOW_END, 0.0, [])) for a, b in pairs]))

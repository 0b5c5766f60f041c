"""Mitsuba's LLVM variant with rays that are on hand: `ray_intersect` and `ray_test`."""

from pathlib import Path
from typing import Any

import numpy as np

from mitsuba_ref.bench.work import ANY, SHADOW_END, Work, blocked, given_rays
from mitsuba_ref.reference.mitsuba_process import dr, mi

VARIANT = "llvm_ad_rgb"


class Raw:
    """options: mode, a folder with the XML; coherent, the hint of that name."""

    def __init__(self, work: Work) -> None:
        mi.set_variant(VARIANT)
        mi.set_log_level(mi.LogLevel.Error)
        self.work = work
        self.xml = Path(work.folder) / work.options["mode"] / "scene.xml"
        self.coherent = bool(work.options.get("coherent", True))

    def build(self, size: int) -> None:
        self.scene = mi.load_file(str(self.xml), optimize=False)
        dr.sync_thread()
        self.size = size

    def take_rays(self) -> None:
        o, d = given_rays(self.work.folder, self.size)
        self.count = len(o)
        self.rays = self._rays(o, d)
        dr.sync_thread()

    def cast(self) -> int:
        """As little as is asked: of all that an interaction holds, only t and the normal are worked out."""
        if self.work.asks == ANY:
            dr.eval(self.scene.ray_test(self.rays, coherent=self.coherent))
        else:
            si = self.scene.ray_intersect(self.rays, int(mi.RayFlags.All), coherent=self.coherent)
            dr.eval(si.t, si.n)
        dr.sync_thread()  # evaluation goes on behind our back
        return self.count

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        rays = self._rays(o, d)
        if self.work.asks == ANY:
            return blocked(self.scene.ray_test(rays, coherent=self.coherent).numpy())
        t = self.scene.ray_intersect(rays, int(mi.RayFlags.All), coherent=self.coherent).t
        return np.broadcast_to(t.numpy(), (len(o),)).astype(np.float64)

    def _rays(self, o: np.ndarray, d: np.ndarray) -> Any:
        points, vectors = ([mi.Float(np.ascontiguousarray(c)) for c in a.T] for a in (o, d))
        end = SHADOW_END if self.work.asks == ANY else np.inf
        t_max = mi.Float(np.full(len(o), end, np.float32))
        rays = mi.Ray3f(mi.Point3f(points), mi.Vector3f(vectors), t_max, mi.Float(0.0), mi.Color0f())
        dr.eval(rays)
        return rays

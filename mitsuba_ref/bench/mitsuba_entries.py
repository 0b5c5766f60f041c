"""Mitsuba: its AOV integrator, `ray_intersect` of arrays of rays, and the scalar variant ray by ray."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mitsuba_ref.bench.entries import ANY, AOVS, LIT, SHADOW_END, CannotRun, Work, blocked, given_rays, sized
from mitsuba_ref.reference.mitsuba_calls import dr, mi

# Our AOVs of one of its interactions.
OF_INTERACTION: dict[str, Callable[[Any], Any]] = {
    "hit": lambda si: si.is_valid(),
    "depth": lambda si: si.t,
    "normal": lambda si: si.n,
    "shading_normal": lambda si: si.sh_frame.n,
    "position": lambda si: si.p,
    "uv": lambda si: si.uv,
    "prim_id": lambda si: si.prim_index,
}
LLVM_VARIANT, SCALAR_VARIANT = "llvm_ad_rgb", "scalar_rgb"


class Integrator:
    """The AOV integrator: Mitsuba's own sensor, one sample per pixel centre. options: variant; mode, a folder; aovs."""

    def __init__(self, work: Work) -> None:
        self.variant: str = work.options["variant"]
        mi.set_variant(self.variant)
        mi.set_log_level(mi.LogLevel.Error)
        self.xml = Path(work.folder) / work.options["mode"] / "scene.xml"
        self.aovs = tuple(work.options.get("aovs", AOVS))

    def build(self, size: int) -> None:
        self.scene = mi.load_file(str(sized(self.xml, size, self.aovs)), optimize=False)
        if not self.scene.sensors():
            raise CannotRun("Mitsuba has no such sensor")
        self.size = size

    def take_rays(self) -> None:
        """The sensor makes them."""

    def cast(self) -> int:
        image = mi.render(self.scene, spp=1)
        dr.eval(image)
        dr.sync_thread()
        return self.size * self.size

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        """The same intersector of the same scene, along rays that no sensor gives."""
        if self.variant.startswith("llvm"):
            rays = mi.Ray3f(
                *(
                    kind([mi.Float(np.ascontiguousarray(c)) for c in a.T])
                    for kind, a in ((mi.Point3f, o), (mi.Vector3f, d))
                )
            )
            return np.broadcast_to(self.scene.ray_intersect(rays).t.numpy(), (len(o),)).astype(np.float64)
        return one_by_one(self.scene, o, d)


def one_by_one(scene: Any, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """t by the scalar variant, ray by ray."""
    pairs = zip(o.tolist(), d.tolist(), strict=True)
    return np.array([scene.ray_intersect(mi.Ray3f(a, b)).t for a, b in pairs], np.float64)


class RayIntersect:
    """`ray_intersect` and `ray_test` of the LLVM variant. options: mode, a folder; coherent, Mitsuba's hint; aovs."""

    def __init__(self, work: Work) -> None:
        mi.set_variant(LLVM_VARIANT)
        mi.set_log_level(mi.LogLevel.Error)
        self.work = work
        self.xml = Path(work.folder) / work.options["mode"] / "scene.xml"
        self.coherent = bool(work.options.get("coherent", True))
        self.aovs = tuple(work.options.get("aovs", AOVS))
        missing = [name for name in self.aovs if name not in OF_INTERACTION and name != LIT]
        if missing:
            raise CannotRun(f"not written for {missing[0]}")

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
        """Evaluates only what is asked for of each interaction."""
        if self.work.workload == ANY:
            dr.eval(self.scene.ray_test(self.rays, coherent=self.coherent))
        else:
            dr.eval(*self.values(self.rays).values())
        dr.sync_thread()  # evaluation is asynchronous
        return self.count

    def values(self, rays: Any) -> dict[str, Any]:
        """The AOVs of the first hits, not evaluated yet."""
        si = self.scene.ray_intersect(rays, int(mi.RayFlags.All), coherent=self.coherent)
        return {name: self._light(si) if name == LIT else OF_INTERACTION[name](si) for name in self.aovs}

    def _light(self, si: Any) -> Any:
        """Radiance by hand: a shadow ray to each emitter and the cosine; ours adds ambient light to it."""
        context, bsdf, total = mi.BSDFContext(), si.bsdf(), mi.Color3f(0.0)
        for emitter in self.scene.emitters():
            sample, weight = emitter.sample_direction(si, mi.Point2f(0.5))
            value = weight * bsdf.eval(context, si, si.to_local(sample.d), si.is_valid())
            bright = dr.any(value > 0.0, axis=0)
            shadowed = self.scene.ray_test(si.spawn_ray_to(sample.p), coherent=self.coherent, active=bright)
            total += dr.select(bright & ~shadowed, value, 0.0)
        return total

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        rays = self._rays(o, d)
        if self.work.workload == ANY:
            return blocked(self.scene.ray_test(rays, coherent=self.coherent).numpy())
        t = self.scene.ray_intersect(rays, int(mi.RayFlags.All), coherent=self.coherent).t
        return np.broadcast_to(t.numpy(), (len(o),)).astype(np.float64)

    def _rays(self, o: np.ndarray, d: np.ndarray) -> Any:
        points, vectors = ([mi.Float(np.ascontiguousarray(c)) for c in a.T] for a in (o, d))
        end = SHADOW_END if self.work.workload == ANY else np.inf
        t_max = mi.Float(np.full(len(o), end, np.float32))
        rays = mi.Ray3f(mi.Point3f(points), mi.Vector3f(vectors), t_max, mi.Float(0.0), mi.Color0f())
        dr.eval(rays)
        return rays


class ScalarLoop:
    """`ray_intersect` of the scalar variant, which takes one ray at a time. options: mode, a folder."""

    def __init__(self, work: Work) -> None:
        mi.set_variant(SCALAR_VARIANT)
        mi.set_log_level(mi.LogLevel.Error)
        self.work = work
        self.xml = Path(work.folder) / work.options["mode"] / "scene.xml"

    def build(self, size: int) -> None:
        self.scene = mi.load_file(str(self.xml), optimize=False)
        self.size = size

    def take_rays(self) -> None:
        o, d = given_rays(self.work.folder, self.size)
        end = SHADOW_END if self.work.workload == ANY else np.inf
        pairs = zip(o.tolist(), d.tolist(), strict=True)
        self.rays = [mi.Ray3f(a, b, end, 0.0, []) for a, b in pairs]

    def cast(self) -> int:
        if self.work.workload == ANY:
            np.array([self.scene.ray_test(ray) for ray in self.rays])
            return len(self.rays)
        t, n = np.empty(len(self.rays), np.float32), np.empty((len(self.rays), 3), np.float32)
        for i, ray in enumerate(self.rays):
            si = self.scene.ray_intersect(ray)
            t[i], n[i] = si.t, si.n
        return len(self.rays)

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        if self.work.workload != ANY:
            return one_by_one(self.scene, o, d)
        pairs = zip(o.tolist(), d.tolist(), strict=True)
        return blocked(np.array([self.scene.ray_test(mi.Ray3f(a, b, SHADOW_END, 0.0, [])) for a, b in pairs]))

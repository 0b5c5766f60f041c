"""Mitsuba: its AOV integrator, `ray_intersect` of arrays of rays, and the scalar variant ray by ray."""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from mitsuba_ref.bench.entries import ANY, SHADOW_END, CannotRun, Work, blocked, given_rays
from mitsuba_ref.reference.mitsuba_calls import dr, mi

INTEGRATOR_AOVS = "depth:depth,normal:geo_normal"
LLVM_VARIANT, SCALAR_VARIANT = "llvm_ad_rgb", "scalar_rgb"


class Integrator:
    """The AOV integrator: Mitsuba's own sensor, one sample per pixel centre. options: variant; mode, a folder."""

    def __init__(self, work: Work) -> None:
        self.variant: str = work.options["variant"]
        mi.set_variant(self.variant)
        mi.set_log_level(mi.LogLevel.Error)
        self.xml = Path(work.folder) / work.options["mode"] / "scene.xml"

    def build(self, size: int) -> None:
        self.scene = mi.load_file(str(sized(self.xml, size)), optimize=False)
        if not self.scene.sensors():
            raise CannotRun("Mitsuba has no such sensor")
        self.integrator = mi.load_dict({"type": "aov", "aovs": INTEGRATOR_AOVS})
        self.size = size

    def take_rays(self) -> None:
        """The sensor makes them."""

    def cast(self) -> int:
        image = mi.render(self.scene, integrator=self.integrator, spp=1)
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


def sized(xml: Path, size: int) -> Path:
    """The same scene with a film of size x size, in a file beside it."""
    tree = ElementTree.parse(xml)
    for name in ("width", "height"):
        for element in tree.iterfind(f"./sensor/film/integer[@name='{name}']"):
            element.set("value", str(size))
    path = xml.with_name(f"scene-{size}.xml")
    tree.write(path)
    return path


class RayIntersect:
    """`ray_intersect` and `ray_test` of the LLVM variant. options: mode, a folder; coherent, Mitsuba's hint."""

    def __init__(self, work: Work) -> None:
        mi.set_variant(LLVM_VARIANT)
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
        """Evaluates only t and the normal of each interaction."""
        if self.work.workload == ANY:
            dr.eval(self.scene.ray_test(self.rays, coherent=self.coherent))
        else:
            si = self.scene.ray_intersect(self.rays, int(mi.RayFlags.All), coherent=self.coherent)
            dr.eval(si.t, si.n)
        dr.sync_thread()  # evaluation is asynchronous
        return self.count

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

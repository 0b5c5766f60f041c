"""Mitsuba: its AOV integrator, and `ray_intersect` of arrays of rays."""

import re
from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from mitsuba_ref.bench.drivers import CannotRun, Driver, Work
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.reference.mitsuba_calls import dr, mi, vectorised_rays

# Our AOVs by the names of its interactions, and of its AOV integrator.
OF_INTERACTION = {
    "depth": "t",
    "normal": "n",
    "shading_normal": "sh_frame.n",
    "position": "p",
    "uv": "uv",
    "prim_id": "prim_index",
}
INTEGRATOR_AOVS = {
    "depth": "depth",
    "normal": "geo_normal",
    "shading_normal": "sh_normal",
    "position": "position",
    "uv": "uv",
    "albedo": "albedo",
    "prim_id": "prim_index",
    "shape_id": "shape_index",
}
LIT = "diffuse"


class OfMitsuba(Driver):
    """A Mitsuba variant. options: variant; mode, the folder of the scene."""

    known: Sequence[str] = ()

    def __init__(self, work: Work) -> None:
        super().__init__(work)
        mi.set_variant(work.options["variant"])
        mi.set_log_level(mi.LogLevel.Error)
        self.xml = Path(work.folder) / work.options["mode"] / "scene.xml"
        missing = [name for name in work.aovs if name not in self.known]
        if missing:
            raise CannotRun(f"not written for {missing[0]}")

    def prepare(self, o: Array, d: Array) -> Any:
        """A ray of arrays, or a list of rays for the scalar variant."""
        if self.work.options["variant"].startswith("scalar"):
            return [mi.Ray3f(a, b, np.inf, 0.0, []) for a, b in zip(o.tolist(), d.tolist(), strict=True)]
        rays = vectorised_rays(o, d, np.full(len(o), np.inf, np.float32))
        dr.eval(rays)
        dr.sync_thread()
        return rays


class Integrator(OfMitsuba):
    """The AOV integrator: Mitsuba's own sensor, one sample per pixel centre."""

    known = (*INTEGRATOR_AOVS, LIT)

    def build(self, size: int) -> None:
        """Load the scene with a film of size x size pixels.

        Light is computed by a nested `direct` integrator with one emitter sample and no BSDF sample.
        """
        self.size = size
        names = ",".join(f"{name}:{INTEGRATOR_AOVS[name]}" for name in self.work.aovs if name != LIT)
        light = {"light": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}} if LIT in self.work.aovs else {}
        self.integrator = mi.load_dict({"type": "aov", "aovs": names, **light})
        text = re.sub(r'(<integer name="(?:width|height)" value=)"\d+"', rf'\1"{size}"', self.xml.read_text())
        file = self.xml.with_name(f"scene-{size}.xml")
        file.write_text(text)
        self.scene = mi.load_file(str(file), optimize=False)
        if not self.scene.sensors():
            raise CannotRun("Mitsuba has no such sensor")

    def take_rays(self, size: int) -> None:
        """Do nothing: the sensor creates the rays."""

    def cast(self) -> int:
        image = mi.render(self.scene, integrator=self.integrator, spp=1)
        dr.eval(image)
        dr.sync_thread()
        return self.size * self.size

    def trace(self, rays: Any) -> Any:
        """Cast given rays by the intersector that the integrator calls."""
        if isinstance(rays, list):
            return np.array([self.scene.ray_intersect(ray).t for ray in rays])
        return self.scene.ray_intersect(rays).t


class RayIntersect(OfMitsuba):
    """`ray_intersect` of the LLVM variant."""

    known = tuple(OF_INTERACTION)

    def build(self, size: int) -> None:
        self.scene = mi.load_file(str(self.xml), optimize=False)
        dr.sync_thread()

    def trace(self, rays: Any) -> Any:
        """Cast rays, and evaluate the requested AOVs only."""
        si = self.scene.ray_intersect(rays, int(mi.RayFlags.All), coherent=True)
        dr.eval(*(attrgetter(OF_INTERACTION[name])(si) for name in self.work.aovs))
        dr.sync_thread()  # evaluation is asynchronous
        return si.t

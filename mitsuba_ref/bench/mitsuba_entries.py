"""Mitsuba: its AOV integrator, and `ray_intersect` of arrays of rays."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from mitsuba_ref.bench.entries import SHADOW_END, CannotRun, Entry, Work
from mitsuba_ref.reference.mitsuba_calls import dr, mi

# Our AOVs: as one of its interactions has them, and by the names of its AOV integrator.
OF_INTERACTION: dict[str, Callable[[Any], Any]] = {
    "depth": lambda si: si.t,
    "normal": lambda si: si.n,
    "shading_normal": lambda si: si.sh_frame.n,
    "position": lambda si: si.p,
    "uv": lambda si: si.uv,
    "prim_id": lambda si: si.prim_index,
}
INTEGRATOR_AOVS = {
    **dict(depth="depth", normal="geo_normal", shading_normal="sh_normal", position="position", uv="uv"),
    **dict(albedo="albedo", prim_id="prim_index", shape_id="shape_index"),
}
LIT = "diffuse"


class OfMitsuba(Entry):
    """options: variant; mode, a folder."""

    known: Sequence[str] = ()

    def __init__(self, work: Work) -> None:
        super().__init__(work)
        mi.set_variant(work.options["variant"])
        mi.set_log_level(mi.LogLevel.Error)
        self.xml = Path(work.folder) / work.options["mode"] / "scene.xml"
        missing = [name for name in work.aovs if name not in self.known and name != LIT]
        if missing:
            raise CannotRun(f"not written for {missing[0]}")

    def prepare(self, o: np.ndarray, d: np.ndarray) -> Any:
        """A ray, or of the scalar variant a list of them."""
        end = SHADOW_END if self.any else np.inf
        if self.work.options["variant"].startswith("scalar"):
            return [mi.Ray3f(a, b, end, 0.0, []) for a, b in zip(o.tolist(), d.tolist(), strict=True)]
        points, vectors = ([mi.Float(np.ascontiguousarray(c)) for c in a.T] for a in (o, d))
        t_max = mi.Float(np.full(len(o), end, np.float32))
        rays = mi.Ray3f(mi.Point3f(points), mi.Vector3f(vectors), t_max, mi.Float(0.0), mi.Color0f())
        dr.eval(rays)
        dr.sync_thread()
        return rays


class Integrator(OfMitsuba):
    """The AOV integrator: Mitsuba's own sensor, one sample per pixel centre."""

    known = tuple(INTEGRATOR_AOVS)

    def build(self, size: int) -> None:
        self.size = size
        self.scene = mi.load_file(str(sized(self.xml, size, self.work.aovs)), optimize=False)
        if not self.scene.sensors():
            raise CannotRun("Mitsuba has no such sensor")

    def take_rays(self, size: int) -> None:
        """The sensor makes them."""

    def cast(self) -> int:
        image = mi.render(self.scene, spp=1)
        dr.eval(image)
        dr.sync_thread()
        return self.size * self.size

    def trace(self, rays: Any) -> Any:
        """The same intersector of the same scene, along rays that no sensor gives."""
        if isinstance(rays, list):
            return np.array([self.scene.ray_intersect(ray).t for ray in rays])
        return self.scene.ray_intersect(rays).t


class RayIntersect(OfMitsuba):
    """`ray_intersect` and `ray_test` of the LLVM variant."""

    known = tuple(OF_INTERACTION)

    def build(self, size: int) -> None:
        self.scene = mi.load_file(str(self.xml), optimize=False)
        dr.sync_thread()

    def trace(self, rays: Any) -> Any:
        """Evaluates only the AOVs that are asked for."""
        if self.any:
            found = self.scene.ray_test(rays, coherent=True)
            dr.eval(found)
        else:
            si = self.scene.ray_intersect(rays, int(mi.RayFlags.All), coherent=True)
            dr.eval(*self.values(si).values())
            found = si.t
        dr.sync_thread()  # evaluation is asynchronous
        return found

    def values(self, si: Any) -> dict[str, Any]:
        """The AOVs of the first hits, not evaluated yet."""
        return {name: self._light(si) if name == LIT else OF_INTERACTION[name](si) for name in self.work.aovs}

    def _light(self, si: Any) -> Any:
        """Radiance by hand: a shadow ray to each emitter and the cosine; ours adds ambient light to it."""
        context, bsdf, total = mi.BSDFContext(), si.bsdf(), mi.Color3f(0.0)
        for emitter in self.scene.emitters():
            sample, weight = emitter.sample_direction(si, mi.Point2f(0.5))
            value = weight * bsdf.eval(context, si, si.to_local(sample.d), si.is_valid())
            bright = dr.any(value > 0.0, axis=0)
            shadowed = self.scene.ray_test(si.spawn_ray_to(sample.p), coherent=True, active=bright)
            total += dr.select(bright & ~shadowed, value, 0.0)
        return total


def sized(xml: Path, size: int, aovs: Sequence[str]) -> Path:
    """The same scene with a film of size x size and an AOV integrator, in a file beside it.

    With `direct` inside for light: one sample of an emitter, none of a BSDF.
    """
    tree = ElementTree.parse(xml)
    root = tree.getroot()
    for element in root.findall("./integrator"):
        root.remove(element)
    names = ",".join(f"{name}:{INTEGRATOR_AOVS[name]}" for name in aovs if name != LIT)
    integrator = ElementTree.SubElement(root, "integrator", type="aov")
    ElementTree.SubElement(integrator, "string", name="aovs", value=names)
    if LIT in aovs:
        direct = ElementTree.SubElement(integrator, "integrator", type="direct", name="radiance")
        ElementTree.SubElement(direct, "integer", name="emitter_samples", value="1")
        ElementTree.SubElement(direct, "integer", name="bsdf_samples", value="0")
    for name in ("width", "height"):
        for element in tree.iterfind(f"./sensor/film/integer[@name='{name}']"):
            element.set("value", str(size))
    path = xml.with_name(f"scene-{size}.xml")
    tree.write(path)
    return path

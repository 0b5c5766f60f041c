"""Mitsuba's AOV integrator: its own sensor, one sample in the middle of each pixel, depth and geometric normal."""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from mitsuba_ref.bench.work import CannotRun, Work
from mitsuba_ref.reference.mitsuba_process import dr, mi

AOVS = "depth:depth,normal:geo_normal"


class Picture:
    """options: variant; mode, a folder with the XML."""

    def __init__(self, work: Work) -> None:
        self.variant: str = work.options["variant"]
        mi.set_variant(self.variant)
        mi.set_log_level(mi.LogLevel.Error)
        self.xml = Path(work.folder) / work.options["mode"] / "scene.xml"

    def build(self, size: int) -> None:
        self.scene = mi.load_file(str(sized(self.xml, size)), optimize=False)
        if not self.scene.sensors():
            raise CannotRun("Mitsuba has no such sensor")
        self.integrator = mi.load_dict({"type": "aov", "aovs": AOVS})
        self.size = size

    def take_rays(self) -> None:
        """It makes its own."""

    def cast(self) -> int:
        image = mi.render(self.scene, integrator=self.integrator, spp=1)
        dr.eval(image)
        dr.sync_thread()
        return self.size * self.size

    def answer(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        """The same intersector, of the same scene, along rays that a sensor cannot be made to give."""
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
    """t by the scalar variant, which takes a ray at a time."""
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

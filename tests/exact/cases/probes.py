"""What Mitsuba makes of what ours refuses, in its own XML; and its sensors against our cameras. Data, not asserted."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cases.shapes import ply_of
from caster import Film, Pinhole, Scene
from caster.geometry.packing import pack
from caster.geometry.world_space import as_float32
from caster.rendering.images import camera_rays
from mitsuba_ref.reference.messages import Crash, TraceRequest, TraceResponse
from mitsuba_ref.reference.mitsuba_process import send_request, send_requests
from mitsuba_ref.reference.shared_input import export, model_of, shared_rays

U = 2.0**-24


class Probe(NamedTuple):
    """One document and rays into it."""

    name: str
    content: str
    o: Sequence[Sequence[float]]
    d: Sequence[Sequence[float]]
    t_max: float = math.inf
    files: Mapping[str, bytes] = {}


class Sensor(NamedTuple):
    """One of our cameras, as a sensor of Mitsuba's."""

    name: str
    camera: Pinhole
    film: Film


DOWN = ([(0.25, 0.125, 3.0)], [(0.0, 0.0, -1.0)])
BAD = [[x if i == axis else 0.25 for i in range(3)] for x in (math.nan, math.inf) for axis in range(3)]


def shape(plugin: str, inner: str = "") -> str:
    return f'<shape type="{plugin}"><bsdf type="diffuse"/>{inner}</shape>'


def moved(matrix: str) -> str:
    return f'<transform name="to_world">{matrix}</transform>'


def number(name: str, value: float) -> str:
    return f'<float name="{name}" value="{value!r}"/>'


def mesh(name: str, corners: Any, faces: Any) -> tuple[str, dict[str, bytes]]:
    content = ply_of(np.asarray(corners, float), np.asarray(faces).reshape(-1, 3), "float")
    return shape("ply", f'<string name="filename" value="{name}"/>'), {name: content}


def indexed(index: int) -> Probe:
    content, files = mesh("bad.ply", [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 1, index]])
    return Probe(f"index {index}", content, *DOWN, files=files)


def sensor(transform: str, film: str) -> str:
    return f'<sensor type="perspective">{moved(transform)}<film type="hdrfilm">{film}</film></sensor>{shape("sphere")}'


def film(width: int, height: int) -> str:
    return f'<integer name="width" value="{width}"/><integer name="height" value="{height}"/>'


STANDING = '<lookat origin="0,0,5" target="0,0,0" up="0,1,0"/>'
EMPTY, NO_FILES = mesh("empty.ply", np.zeros((0, 3)), np.zeros((0, 3), int))
FACELESS, CORNERS_ONLY = mesh("faceless.ply", np.eye(3), np.zeros((0, 3), int))
RIGHT = ([(0.25, 0.125, 3.0)] * 2, [(0.0, 0.0, -1.0)] * 2)

PROBES: dict[int, tuple[Probe | Sensor, ...]] = {
    11: tuple(Probe(f"radius {r:g}", shape("sphere", number("radius", r)), *DOWN) for r in (0.0, -1.0, 1e-38)),
    39: tuple(indexed(i) for i in (3, 10**6, 0xFFFFFFFF)),
    40: (
        Probe("nothing", "", *DOWN),
        Probe("no faces, no vertices", EMPTY, *DOWN, files=NO_FILES),
        Probe("no faces", FACELESS, *DOWN, files=CORNERS_ONLY),
    ),
    49: tuple(
        Probe(f"{plugin} scaled by {x}", shape(plugin, moved(f'<scale value="{x}"/>')), *DOWN)
        for plugin in ("rectangle", "disk", "sphere", "cylinder")
        for x in ("1 1 0", "0 1 1")
    ),
    66: tuple(
        Sensor(f"fov {fov:g}", Pinhole(eye=(1, 2, 5), look_at=(0, 0, 0), fov=fov), Film(width=64, height=32))
        for fov in (0.001, 0.1, 1.0, 45.0, 120.0, 170.0, 179.9, 179.99)
    ),
    67: tuple(
        Sensor(f"near {near:g}", Pinhole(eye=(1, 2, 5), look_at=(0, 0, 0), near=near), Film(width=16, height=16))
        for near in (1e-4, 0.1, 5.0)
    ),
    68: tuple(
        Sensor(f"far {far:g}", Pinhole(eye=(1, 2, 5), look_at=(0, 0, 0), near=0.1, far=far), Film(width=16, height=16))
        for far in (1.0, 1e4)
    ),
    69: tuple(
        Sensor(f"{w}x{h}", Pinhole(eye=(1, 2, 5), look_at=(0, 0, 0)), Film(width=w, height=h))
        for w, h in ((1, 1), (1, 7), (7, 1), (2, 2), (3, 3))
    ),
    70: tuple(
        Sensor(f"{w} wide", Pinhole(eye=(1, 2, 5), look_at=(0, 0, 0)), Film(width=w, height=1, crop=(0, 0, 500, 1)))
        for w in (4096, 65536)
    ),
    71: tuple(
        Probe(name, sensor(f"<lookat {text}/>", film(4, 4)), *DOWN)
        for name, text in (
            ("the same point", 'origin="1,2,3" target="1,2,3" up="0,1,0"'),
            ("up along the view", 'origin="0,0,5" target="0,0,0" up="0,0,1"'),
        )
    ),
    72: tuple(Probe(f"film {w}x{h}", sensor(STANDING, film(w, h)), *DOWN) for w, h in ((0, 1), (1, 0))),
    73: tuple(
        Sensor(f"from {away:g}", Pinhole(eye=(0.6 * away, 0, 0.8 * away), look_at=(0, 0, 0)), Film(width=16, height=16))
        for away in (1e2, 1e4, 1e6, 1e8)
    ),
    74: (
        Probe(
            "a unit rectangle about (1, 1, 1), seen at what its turn would reach",
            shape("rectangle", moved('<rotate x="1" y="1" z="1" angle="120"/>')),
            [(3.0, 0.5, 0.25), (3.0, 1.5, 0.25)],
            [(-1.0, 0.0, 0.0)] * 2,
        ),
    ),
    75: (
        Probe("origins with NaN and inf", shape("sphere"), BAD, [DOWN[1][0]] * len(BAD)),
        Probe("directions with NaN and inf", shape("sphere"), [DOWN[0][0]] * len(BAD), BAD),
        *(Probe(f"t_max {t_max:g}", shape("sphere"), *DOWN, t_max=t_max) for t_max in (math.nan, -1.0, 0.0, 3.4e38)),
    ),
    76: (Probe("no direction", shape("sphere"), *DOWN[:1], [(0.0, 0.0, 0.0)]),),
}


def probed(numbers: Sequence[int], variant: str, folder: Path) -> dict[str, dict[str, str]]:
    """{number: {name: what Mitsuba did}}."""
    chosen = [(i, probe) for i in numbers for probe in PROBES.get(i, ())]
    asked = [
        (i, probe, job(probe, variant, folder / f"{i}-{j}"))
        for j, (i, probe) in enumerate(chosen)
        if isinstance(probe, Probe)
    ]
    found: dict[str, dict[str, str]] = {}
    for (i, probe, _), answer in zip(asked, send_requests([job for _, _, job in asked]) if asked else [], strict=True):
        found.setdefault(str(i), {})[probe.name] = told(answer)
    for j, (i, probe) in enumerate(chosen):
        if isinstance(probe, Sensor):
            found.setdefault(str(i), {})[probe.name] = directions(probe, variant, folder / f"sensor-{j}")
    return found


def job(probe: Probe, variant: str, folder: Path) -> TraceRequest:
    folder.mkdir(parents=True)
    head = '<scene version="3.0.0"><boolean name="embree_use_robust_intersections" value="true"/>'
    (folder / "scene.xml").write_text(f"{head}{probe.content}</scene>")
    for name, content in probe.files.items():
        (folder / name).write_bytes(content)
    o, d = np.array(probe.o, np.float32), np.array(probe.d, np.float32)
    return TraceRequest(
        folder / "scene.xml", variant, o, d, np.full(len(o), probe.t_max, np.float32), lights=False, strict=False
    )


def told(answer: TraceResponse | Crash) -> str:
    if isinstance(answer, Crash):
        return "refused" if answer.kind == "error" else f"crashed ({answer.kind})"
    nan = int(np.isnan(answer.t).sum())
    hit = int((answer.t < np.inf).sum())
    return f"{hit} of {len(answer.t)} hit" + (f", {nan} with a t that is NaN" if nan else "")


def directions(probe: Sensor, variant: str, folder: Path) -> str:
    """How far the directions of Mitsuba's sensor are from ours, in 2^-24."""
    scene = Scene(film=probe.film, camera=probe.camera)
    xml = export(scene, model_of(scene, pack(scene, as_float32), shared_rays(scene))).write(folder)
    none = np.zeros((0, 3), np.float32)
    answer = send_request(
        TraceRequest(xml, variant, none, none, np.zeros(0, np.float32), lights=False, sensor=True, strict=False)
    )
    if isinstance(answer, Crash) or answer.sensor_d is None or answer.sensor_o is None:
        return told(answer) if isinstance(answer, Crash) else "no sensor"
    rays = camera_rays(scene)
    apart = float(np.linalg.norm(answer.sensor_d - rays.d, axis=1).max()) / U
    start = float(np.linalg.norm(answer.sensor_o - (rays.o + rays.t_min[:, None] * rays.d), axis=1).max())
    return f"directions within {apart:.2g} u, origins within {start:.2g}"

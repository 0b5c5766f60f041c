"""Scenes in Mitsuba's own XML, and rays through them, for the tests that ask Mitsuba."""

from pathlib import Path
from typing import Any

import numpy as np
from ply_files import ply_mesh

import caster
from caster.scene.model import Scene
from mitsuba_ref.judge.classification import Judge, judge_of
from mitsuba_ref.reference.messages import Crash, TraceRequest, TraceResponse
from mitsuba_ref.reference.mitsuba_process import SendRequest, send_request
from mitsuba_ref.reference.variants import EXACT_T_ERROR
from mitsuba_ref.subjects.requests import request_answer
from mitsuba_ref.subjects.subject import OURS, Subject

VARIANTS = ("scalar_rgb", "llvm_ad_rgb")
DIFFUSE = '<bsdf type="diffuse"><rgb name="reflectance" value="0.5 0.25 0.75"/></bsdf>'


def scene_judge(scene: Scene, subject: Subject = OURS, send: SendRequest = send_request) -> Judge | Crash:
    """The judge of a subject in the film's window."""
    return judge_of(request_answer(subject, scene), send=send)


def lit_scene(*shapes: Any, **more: Any) -> Scene:
    """Shapes around the origin, seen by a small film, with one light unless others are given."""
    lamp = caster.Point(position=(2, 5, 3), intensity=(30, 30, 30))
    camera = caster.Pinhole(eye=(0.1, 0.2, 5), look_at=(0, 0, 0), fov=40)
    usual = {"film": caster.Film(width=36, height=24), "camera": camera, "lights": [lamp]}
    return Scene(**(usual | more), shapes=shapes)


def write(folder: Path, content: str, name: str = "scene.xml") -> Path:
    path = folder / name
    path.write_text(
        '<scene version="3.0.0">\n<boolean name="embree_use_robust_intersections" value="true"/>\n'
        f"{content}\n</scene>\n"
    )
    return path


def shape(plugin: str, name: str, x: float, y: float = 0.0, content: str = DIFFUSE, stretch: str = "1 1 1") -> str:
    """One shape of about unit size around (x, y, 0)."""
    a, b, c = stretch.split()
    matrix = f"{a} 0 0 {x} 0 {b} 0 {y} 0 0 {c} 0 0 0 0 1"
    place = f'<transform name="to_world"><matrix value="{matrix}"/></transform>'
    return f'<shape type="{plugin}" id="{name}">{place}{content}</shape>'


def point_light(position: str, intensity: str) -> str:
    numbers = f'<point name="position" value="{position}"/><rgb name="intensity" value="{intensity}"/>'
    return f'<emitter type="point">{numbers}</emitter>'


def sun(direction: str, irradiance: str) -> str:
    numbers = f'<vector name="direction" value="{direction}"/><rgb name="irradiance" value="{irradiance}"/>'
    return f'<emitter type="directional">{numbers}</emitter>'


def film(width: int, height: int) -> str:
    """One sample in each pixel's centre, and the sampler for it."""
    size = f'<integer name="width" value="{width}"/><integer name="height" value="{height}"/>'
    return (
        f'<film type="hdrfilm">{size}<string name="component_format" value="float32"/><rfilter type="box"/></film>'
        '<sampler type="stratified"><integer name="sample_count" value="1"/>'
        '<boolean name="jitter" value="false"/></sampler>'
    )


def random_mesh(path: Path, rng: np.random.Generator, triangles: int = 200) -> np.ndarray:
    """Triangles strewn over a cube of size 2 as a PLY without normals; returns (triangles, 3, 3) float32."""
    corners = rng.uniform(-1.0, 1.0, (triangles, 1, 3)) + rng.normal(0.0, 0.15, (triangles, 3, 3))
    corners = corners.astype(np.float32)
    faces = np.arange(3 * triangles).reshape(-1, 3).tolist()
    path.write_bytes(ply_mesh("binary_little_endian", corners.reshape(-1, 3).tolist(), faces))
    return corners


def job(xml: Path, variant: str, o: object, d: object, t_max: float = np.inf, **wanted: bool) -> TraceRequest:
    """The same t_max for every ray."""
    o, d = (np.ascontiguousarray(rows, np.float32).reshape(-1, 3) for rows in (o, d))
    return TraceRequest(xml, variant, o, d, np.full(len(o), t_max, np.float32), **wanted)


def has_t(answer: TraceResponse, *expected: float) -> bool:
    """Whether triangles of small integers are hit at these t, and missed where inf is expected.

    No t of a triangle is the same on every CPU: Embree multiplies by an approximate reciprocal.
    """
    return len(answer.t) == len(expected) and np.allclose(answer.t.astype(float), expected, rtol=EXACT_T_ERROR, atol=0)

"""Mitsuba's scalar variant, ray by ray from Python: slow, and float64 inside spheres and cylinders.

`mi` is the module mitsuba, which only the door imports.
"""

from collections.abc import Iterable, Iterator
from itertools import chain
from typing import Any

import numpy as np

from mitsuba_ref.reference.messages import TraceRequest, TraceResponse

BAND = 16384  # rays whose hits are held at a time: a hit takes 500 bytes
CENTER = (0.5, 0.5)  # of the aperture and of a light that is a point: no choice depends on it


def trace(mi: Any, scene: Any, job: TraceRequest) -> dict[str, np.ndarray]:
    """Every array of an Answer but the sensor's."""
    emitters = scene.emitters() if job.lights else []
    found = _misses(len(job.o), len(emitters))
    index = {shape: i for i, shape in enumerate(scene.shapes())}
    for start in range(0, len(job.o), BAND):
        rows, hits = _hits(mi, scene, job, start)
        _surface(found, rows, hits, index)
        if job.lights:
            found["albedo"][rows] = _rows((si.bsdf().eval_diffuse_reflectance(si) for si in hits), 3)
        for k, emitter in enumerate(emitters):
            rgb, visible = _light(mi, scene, emitter, hits)
            found["light_rgb"][k, rows], found["light_visible"][k, rows] = rgb, visible
    return found


def sensor_rays(mi: Any, sensor: Any, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
    """o, d, t_max through points of the film, which are in [0, 1]^2 across the crop window."""
    aperture, point = mi.Point2f(CENTER), mi.Point2f
    pairs = zip(x.tolist(), y.tolist(), strict=True)
    rays = [sensor.sample_ray(0.0, 0.5, point(*pair), aperture)[0] for pair in pairs]
    t_max = np.array([ray.maxt for ray in rays], np.float32)
    return _rows((ray.o for ray in rays), 3), _rows((ray.d for ray in rays), 3), t_max


def _misses(rays: int, lights: int) -> dict[str, np.ndarray]:
    found: dict[str, np.ndarray] = {
        name: np.zeros((rays, *row), dtype) for name, (row, dtype) in TraceResponse.ROWS.items()
    }
    found["t"][:] = np.inf
    found["shape"][:] = found["prim"][:] = -1
    found["light_rgb"] = np.zeros((lights, rays, 3), np.float32)
    found["light_visible"] = np.zeros((lights, rays), np.bool_)
    return found


def _hits(mi: Any, scene: Any, job: TraceRequest, start: int) -> tuple[list[int], list[Any]]:
    """The rays from `start` on, one band of them: which of them hit, and what."""
    rows, hits = [], []
    ray, intersect = mi.Ray3f, scene.ray_intersect
    band = slice(start, start + BAND)
    numbers = zip(job.o[band].tolist(), job.d[band].tolist(), job.t_max[band].tolist(), strict=True)
    for i, (o, d, t_max) in enumerate(numbers, start):
        si = intersect(ray(o, d, t_max, 0.0, []))
        if si.is_valid():
            rows.append(i)
            hits.append(si)
    return rows, hits


def _surface(found: dict[str, np.ndarray], rows: list[int], hits: list[Any], index: dict[Any, int]) -> None:
    found["t"][rows] = [si.t for si in hits]
    found["n"][rows] = _rows((si.n for si in hits), 3)
    found["sh_n"][rows] = _rows((si.sh_frame.n for si in hits), 3)
    found["p"][rows] = _rows((si.p for si in hits), 3)
    found["uv"][rows] = _rows((si.uv for si in hits), 2)
    found["shape"][rows] = [index[si.instance or si.shape] for si in hits]
    found["prim"][rows] = [si.prim_index for si in hits]


def _light(mi: Any, scene: Any, emitter: Any, hits: list[Any]) -> tuple[np.ndarray, list[bool]]:
    """What Mitsuba's `direct` integrator adds up, with its shadow test kept apart."""
    context, sample = mi.BSDFContext(), mi.Point2f(CENTER)
    directions = [emitter.sample_direction(si, sample) for si in hits]
    pairs = zip(hits, directions, strict=True)
    visible = [not scene.ray_test(si.spawn_ray_to(ds.p)) for si, (ds, _) in pairs]
    return _rows(_reflected(context, hits, directions), 3), visible


def _reflected(context: Any, hits: list[Any], directions: list[Any]) -> Iterator[Any]:
    for si, (ds, weight) in zip(hits, directions, strict=True):
        yield weight * si.bsdf().eval(context, si, si.to_local(ds.d))


def _rows(vectors: Iterable[Any], width: int) -> np.ndarray:
    """Vectors of Mitsuba's float32 numbers as an array; one by one takes twenty times as long."""
    return np.fromiter(chain.from_iterable(vectors), np.float32).reshape(-1, width)

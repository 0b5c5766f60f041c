"""Mitsuba's LLVM variant: all rays at once, float32 throughout.

`mi` and `dr` are the modules mitsuba and drjit, which only the door imports.
"""

from typing import Any

import numpy as np

from mitsuba_ref.reference.messages import TraceRequest

CENTER = (0.5, 0.5)  # of the aperture and of a light that is a point: no choice depends on it


def trace(mi: Any, dr: Any, scene: Any, job: TraceRequest) -> dict[str, np.ndarray]:
    """Every array of an Answer but the sensor's."""
    o, d = (_columns(mi, array) for array in (job.o, job.d))
    ray = mi.Ray3f(mi.Point3f(o), mi.Vector3f(d), mi.Float(job.t_max), mi.Float(0.0), mi.Color0f())
    si = scene.ray_intersect(ray, int(mi.RayFlags.All), True)  # coherent: a hint that changes no bit
    hit = si.is_valid()
    albedo = si.bsdf().eval_diffuse_reflectance(si, hit) if job.lights else mi.Color3f(0.0)
    lights = [_light(mi, scene, emitter, si, hit) for emitter in (scene.emitters() if job.lights else [])]
    dr.eval(si, hit, albedo, lights)
    return _surface(mi, dr, scene, si, hit, len(job.o)) | _lit(dr, albedo, lights, hit, len(job.o))


def sensor_rays(mi: Any, sensor: Any, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
    """o, d, t_max through points of the film, which are in [0, 1]^2 across the crop window."""
    ray, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(mi.Float(x), mi.Float(y)), mi.Point2f(CENTER))
    return _rows(ray.o, len(x)), _rows(ray.d, len(x)), _column(ray.maxt, len(x))


def _light(mi: Any, scene: Any, emitter: Any, si: Any, hit: Any) -> tuple[Any, Any]:
    """What Mitsuba's `direct` integrator adds up, with its shadow test kept apart."""
    ds, weight = emitter.sample_direction(si, mi.Point2f(CENTER), hit)
    rgb = weight * si.bsdf().eval(mi.BSDFContext(), si, si.to_local(ds.d), hit)
    return rgb, hit & ~scene.ray_test(si.spawn_ray_to(ds.p), hit)


def _surface(mi: Any, dr: Any, scene: Any, si: Any, hit: Any, rays: int) -> dict[str, np.ndarray]:
    vectors = {"n": si.n, "sh_n": si.sh_frame.n, "p": si.p, "uv": si.uv}
    prim = dr.select(hit, mi.Int32(si.prim_index), -1)
    return {
        "t": _column(si.t, rays),
        "shape": _shapes(mi, dr, scene, si, rays),
        "prim": _column(prim, rays, np.int32),
    } | {name: _rows(dr.select(hit, vector, 0.0), rays) for name, vector in vectors.items()}


def _shapes(mi: Any, dr: Any, scene: Any, si: Any, rays: int) -> np.ndarray:
    """Places in scene.shapes(). Dr.Jit numbers shapes in an order of its own, from 1; 0 is no shape."""
    shape, instance = (dr.reinterpret_array(mi.UInt32, pointer) for pointer in (si.shape, si.instance))
    numbers = _column(dr.select(instance != 0, instance, shape), rays, np.uint32)
    known = dr.reinterpret_array(mi.UInt32, scene.shapes_dr()).numpy()
    place = np.full(max(numbers.max(initial=0), known.max(initial=0)) + 1, -1, np.int32)
    place[known] = np.arange(len(known))
    place[0] = -1
    return place[numbers]


def _lit(dr: Any, albedo: Any, lights: list[tuple[Any, Any]], hit: Any, rays: int) -> dict[str, np.ndarray]:
    rgb = [_rows(dr.select(hit, light, 0.0), rays) for light, _ in lights]
    visible = [_column(seen, rays, np.bool_) for _, seen in lights]
    return {
        "albedo": _rows(dr.select(hit, albedo, 0.0), rays),
        "light_rgb": np.array(rgb, np.float32).reshape(len(lights), rays, 3),
        "light_visible": np.array(visible, np.bool_).reshape(len(lights), rays),
    }


def _columns(mi: Any, rows: np.ndarray) -> list[Any]:
    return [mi.Float(np.ascontiguousarray(column)) for column in rows.T]


def _column(values: Any, rays: int, dtype: type = np.float32) -> np.ndarray:
    """One number for each ray; Dr.Jit keeps a single one where all are the same."""
    return np.broadcast_to(values.numpy().astype(dtype, copy=False), (rays,)).copy()


def _rows(vector: Any, rays: int) -> np.ndarray:
    return np.stack([_column(component, rays) for component in vector], axis=1)

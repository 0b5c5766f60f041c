"""Calls of Mitsuba. The only module that imports it; loaded only in a child process, since Mitsuba may crash it.

Requests come through mitsuba_process.py. The scalar variant is called ray by ray from Python: it is slow, and computes
spheres and cylinders in float64. The LLVM variant takes all rays at once, in float32 throughout.
"""

import os
import time
from collections.abc import Iterable
from itertools import chain
from typing import Any

import drjit
import mitsuba
import numpy as np

from caster.system import processor
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.messages import TraceRequest, TraceResponse
from mitsuba_ref.scene_xml.elements import shape_and_part

LLVM_PREFIX = "llvm"  # of vectorised variants
SCALAR_RAYS_PER_CHUNK = 16384  # limits memory: a hit takes 500 bytes
CENTER = (0.5, 0.5)  # sample of the aperture or of a light; for points it does not matter

# The type stubs do not cover variants.
mi: Any = mitsuba
dr: Any = drjit


def trace_request(request: TraceRequest) -> TraceResponse:
    """Load the scene and trace the rays in this process. Prints nothing.

    Raises RuntimeError with Mitsuba's message where it refuses the scene, or only warns and the request is strict, and
    ImportError where it refuses the variant.
    """
    mi.set_variant(request.variant)
    _set_log_level(request.strict)
    start = time.perf_counter()
    scene = mi.load_file(str(request.xml), optimize=False)  # optimising merges meshes and loses their ids
    arrays: dict[str, Any] = _trace(scene, request) | _sensor_rays(scene, request) | _meshes(request)
    seconds = time.perf_counter() - start
    names = _in_scene_shapes([shape.id() for shape in scene.shapes()], arrays)
    return TraceResponse(names=names, versions=_versions(request.variant), seconds=seconds, **arrays)


def _in_scene_shapes(ids: list[str], arrays: dict[str, Any]) -> list[str]:
    """Names of the scene's shapes. Where one of them was exported as several, `prim` becomes the number of the part."""
    if not any(each.endswith("}") for each in ids):
        return ids
    names, parts = zip(*map(shape_and_part, ids), strict=True)
    index = {name: i for i, name in enumerate(dict.fromkeys(names))}
    part = np.array([*parts, -1], np.int32)[arrays["shape"]]
    arrays["prim"] = np.where(part < 0, arrays["prim"], part)
    arrays["shape"] = np.array([*(index[name] for name in names), -1], np.int32)[arrays["shape"]]
    return list(index)


def _set_log_level(strict: bool) -> None:
    """If strict, make warnings errors; log nothing to stdout, where commands print results."""
    logger = mi.logger()
    logger.clear_appenders()
    logger.set_error_level(mi.LogLevel.Warn if strict else mi.LogLevel.Error)


def _trace(scene: Any, request: TraceRequest) -> dict[str, Any]:
    """All arrays of a TraceResponse except the sensor's."""
    if request.variant.startswith(LLVM_PREFIX) and len(request.o):
        return _trace_llvm(scene, request)
    return _trace_scalar(scene, request)  # no rays: empty arrays, whatever the variant


def _sensor_rays(scene: Any, request: TraceRequest) -> dict[str, Any]:
    names = ("sensor_o", "sensor_d", "sensor_t_max")
    if not request.sensor or not scene.sensors():
        return dict.fromkeys(names)
    sensor = scene.sensors()[0]
    sample = _llvm_sensor_rays if request.variant.startswith(LLVM_PREFIX) else _scalar_sensor_rays
    return dict(zip(names, sample(sensor, *_pixel_centers(sensor.film())), strict=True))


def _meshes(request: TraceRequest) -> dict[str, Any]:
    """The request's mesh files as Mitsuba's loader reads them, corner by corner, or its message if it refuses one."""
    mi.logger().set_error_level(mi.LogLevel.Error)  # a warning about a file is not one about the scene
    found, faces, problems = [np.zeros((0, 3, 8), np.float32)], [np.zeros((0, 3), np.int32)], []
    for file in request.mesh_files:
        try:
            mesh = mi.load_dict({"type": file.suffix[1:].lower(), "filename": str(file)})
            parameters = mi.traverse(mesh)
            faces.append(np.array(parameters["faces"], np.int32).reshape(-1, 3))
            found.append(_vertices(parameters)[faces[-1]])
            problems.append("")
        except RuntimeError as error:
            faces.append(faces[0])
            found.append(found[0])
            problems.append(str(error))
    return {
        "mesh_corners": np.concatenate(found),
        "mesh_vertices": np.concatenate(faces),
        "mesh_faces": [len(each) for each in found[1:]],
        "mesh_problems": problems,
    }


def _vertices(parameters: Any) -> np.ndarray:
    """(n, 8) position, normal and uv of each vertex; missing ones are 0."""
    rows = np.zeros((np.array(parameters["vertex_positions"]).size // 3, 8), np.float32)
    for name, columns in (("positions", slice(0, 3)), ("normals", slice(3, 6)), ("texcoords", slice(6, 8))):
        values = np.array(parameters[f"vertex_{name}"], np.float32)
        if values.size:
            rows[:, columns] = values.reshape(len(rows), -1)
    return rows


def _pixel_centers(film: Any) -> tuple[np.ndarray, np.ndarray]:
    """x and y of the crop window's pixel centres, row by row, rounded as in Mitsuba's integrators."""
    (x0, y0), (width, height) = film.crop_offset(), film.crop_size()
    y, x = np.meshgrid(_centers(y0, height), _centers(x0, width), indexing="ij")
    return np.ascontiguousarray(x.ravel()), np.ascontiguousarray(y.ravel())


def _centers(offset: int, size: int) -> np.ndarray:
    """fma(offset + k + 1/2, 1/size, -offset/size) in float32; float64 holds the product of two float32 exactly."""
    scale = np.float32(1.0) / np.float32(size)
    shift = np.float64(-np.float32(offset) * scale)
    return ((offset + np.arange(size) + 0.5) * np.float64(scale) + shift).astype(np.float32)


def _versions(variant: str) -> dict[str, str]:
    library = os.environ.get(variants.LIBLLVM_ENVIRONMENT_VARIABLE) if variant.startswith(LLVM_PREFIX) else None
    return {
        "mitsuba": mi.__version__,
        "drjit": dr.__version__,
        "variant": variant,
        "libllvm": library or "none",
        "processor": processor.description(),
    }


# ---- the scalar variant


def _trace_scalar(scene: Any, request: TraceRequest) -> dict[str, np.ndarray]:
    emitters = scene.emitters() if request.lights else []
    found = _misses(len(request.o), len(emitters))
    index = {shape: i for i, shape in enumerate(scene.shapes())}
    for start in range(0, len(request.o), SCALAR_RAYS_PER_CHUNK):
        rows, places, hits = _scalar_hits(scene, request, slice(start, start + SCALAR_RAYS_PER_CHUNK))
        for name, values in _scalar_surface(places, hits, index).items():
            found[name][rows] = values
        if request.lights:
            found["albedo"][rows] = _array_of((si.bsdf().eval_diffuse_reflectance(si) for si in hits), 3)
        for k, emitter in enumerate(emitters):
            found["light_rgb"][k, rows], found["light_visible"][k, rows] = _scalar_light(scene, emitter, hits)
    return found


def _misses(rays: int, lights: int) -> dict[str, np.ndarray]:
    found: dict[str, np.ndarray] = {
        name: np.zeros((rays, *row), dtype) for name, (row, dtype) in TraceResponse.ROWS.items()
    }
    found["t"][:] = np.inf
    found["shape"][:] = found["prim"][:] = -1
    found["light_rgb"] = np.zeros((lights, rays, 3), np.float32)
    found["light_visible"] = np.zeros((lights, rays), np.bool_)
    return found


def _scalar_hits(scene: Any, request: TraceRequest, chunk: slice) -> tuple[list[int], list[Any], list[Any]]:
    """For the hits of one chunk: rows, places on the primitives, surface interactions."""
    rows, places, hits = [], [], []
    make_ray, intersect, flags = mi.Ray3f, scene.ray_intersect_preliminary, int(mi.RayFlags.All)
    numbers = (array[chunk].tolist() for array in (request.o, request.d, request.t_max))
    for i, (o, d, t_max) in enumerate(zip(*numbers, strict=True), chunk.start):
        ray = make_ray(o, d, t_max, 0.0, [])
        pi = intersect(ray)
        if pi.is_valid():
            rows.append(i)
            places.append(pi.prim_uv)
            hits.append(pi.compute_surface_interaction(ray, flags))
    return rows, places, hits


def _scalar_surface(places: list[Any], hits: list[Any], index: dict[Any, int]) -> dict[str, Any]:
    return {
        "t": [si.t for si in hits],
        "n": _array_of((si.n for si in hits), 3),
        "sh_n": _array_of((si.sh_frame.n for si in hits), 3),
        "p": _array_of((si.p for si in hits), 3),
        "uv": _array_of((si.uv for si in hits), 2),
        "prim_uv": _array_of(places, 2),
        "shape": [index[si.instance or si.shape] for si in hits],
        "prim": [si.prim_index for si in hits],
    }


def _scalar_light(scene: Any, emitter: Any, hits: list[Any]) -> tuple[np.ndarray, list[bool]]:
    """The terms that Mitsuba's `direct` integrator sums, with its shadow test kept separate."""
    context, sample = mi.BSDFContext(), mi.Point2f(CENTER)
    rgb, visible = [], []
    for si in hits:
        ds, weight = emitter.sample_direction(si, sample)
        rgb.append(weight * si.bsdf().eval(context, si, si.to_local(ds.d)))
        visible.append(not scene.ray_test(si.spawn_ray_to(ds.p)))
    return _array_of(rgb, 3), visible


def _scalar_sensor_rays(sensor: Any, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
    """o, d, t_max through film points, given in [0, 1]^2 of the crop window."""
    aperture, point = mi.Point2f(CENTER), mi.Point2f
    pairs = zip(x.tolist(), y.tolist(), strict=True)
    rays = [sensor.sample_ray(0.0, 0.5, point(*pair), aperture)[0] for pair in pairs]
    t_max = np.array([ray.maxt for ray in rays], np.float32)
    return _array_of((ray.o for ray in rays), 3), _array_of((ray.d for ray in rays), 3), t_max


def _array_of(vectors: Iterable[Any], width: int) -> np.ndarray:
    """Mitsuba's float32 vectors as an array; converting them one by one takes twenty times as long."""
    return np.fromiter(chain.from_iterable(vectors), np.float32).reshape(-1, width)


# ---- the LLVM variant


def _trace_llvm(scene: Any, request: TraceRequest) -> dict[str, np.ndarray]:
    count = len(request.o)
    o, d = (_to_drjit(array) for array in (request.o, request.d))
    ray = mi.Ray3f(mi.Point3f(o), mi.Vector3f(d), mi.Float(request.t_max), mi.Float(0.0), mi.Color0f())
    pi = scene.ray_intersect_preliminary(ray, coherent=True)  # a hint that changes no bit
    si = pi.compute_surface_interaction(ray, int(mi.RayFlags.All))
    hit = si.is_valid()
    albedo = si.bsdf().eval_diffuse_reflectance(si, hit) if request.lights else mi.Color3f(0.0)
    lights = [_llvm_light(scene, emitter, si, hit) for emitter in (scene.emitters() if request.lights else [])]
    dr.eval(pi, si, hit, albedo, lights)
    return _llvm_surface(scene, pi, si, hit, count) | _llvm_lighting(albedo, lights, hit, count)


def _llvm_light(scene: Any, emitter: Any, si: Any, hit: Any) -> tuple[Any, Any]:
    """The terms that Mitsuba's `direct` integrator sums, with its shadow test kept separate."""
    ds, weight = emitter.sample_direction(si, mi.Point2f(CENTER), hit)
    rgb = weight * si.bsdf().eval(mi.BSDFContext(), si, si.to_local(ds.d), hit)
    return rgb, hit & ~scene.ray_test(si.spawn_ray_to(ds.p), hit)


def _llvm_surface(scene: Any, pi: Any, si: Any, hit: Any, count: int) -> dict[str, np.ndarray]:
    vectors = {"n": si.n, "sh_n": si.sh_frame.n, "p": si.p, "uv": si.uv, "prim_uv": pi.prim_uv}
    prim = dr.select(hit, mi.Int32(si.prim_index), -1)
    return {
        "t": _column(si.t, count),
        "shape": _llvm_shapes(scene, si, count),
        "prim": _column(prim, count, np.int32),
    } | {name: _columns(dr.select(hit, vector, 0.0), count) for name, vector in vectors.items()}


def _llvm_shapes(scene: Any, si: Any, count: int) -> np.ndarray:
    """Indices into scene.shapes(). Dr.Jit numbers shapes from 1 in its own order; 0 means no shape."""
    shape, instance = (dr.reinterpret_array(mi.UInt32, pointer) for pointer in (si.shape, si.instance))
    numbers = _column(dr.select(instance != 0, instance, shape), count, np.uint32)
    known = dr.reinterpret_array(mi.UInt32, scene.shapes_dr()).numpy()
    index = np.full(max(numbers.max(initial=0), known.max(initial=0)) + 1, -1, np.int32)
    index[known] = np.arange(len(known))
    index[0] = -1
    return index[numbers]


def _llvm_lighting(albedo: Any, lights: list[tuple[Any, Any]], hit: Any, count: int) -> dict[str, np.ndarray]:
    rgb = [_columns(dr.select(hit, light, 0.0), count) for light, _ in lights]
    visible = [_column(lit, count, np.bool_) for _, lit in lights]
    return {
        "albedo": _columns(dr.select(hit, albedo, 0.0), count),
        "light_rgb": np.array(rgb, np.float32).reshape(len(lights), count, 3),
        "light_visible": np.array(visible, np.bool_).reshape(len(lights), count),
    }


def _llvm_sensor_rays(sensor: Any, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
    """o, d, t_max through film points, given in [0, 1]^2 of the crop window."""
    ray, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(mi.Float(x), mi.Float(y)), mi.Point2f(CENTER))
    return _columns(ray.o, len(x)), _columns(ray.d, len(x)), _column(ray.maxt, len(x))


def _to_drjit(rows: np.ndarray) -> list[Any]:
    return [mi.Float(np.ascontiguousarray(column)) for column in rows.T]


def _column(values: Any, count: int, dtype: type = np.float32) -> np.ndarray:
    """One value for each ray; Dr.Jit keeps a single one where all are equal."""
    return np.broadcast_to(values.numpy().astype(dtype, copy=False), (count,)).copy()


def _columns(vector: Any, count: int) -> np.ndarray:
    return np.stack([_column(component, count) for component in vector], axis=1)

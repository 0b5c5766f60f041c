"""Calls of Mitsuba. Only this module and file_calls.py import it, in a child process, since Mitsuba may crash it.

Requests come through mitsuba_process.py. The scalar variant is called ray by ray from Python: it is slow, and computes
spheres and cylinders in float64. The LLVM variant takes all rays at once, in float32 throughout.
"""

import os
import time
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import drjit
import mitsuba
import numpy as np

from caster.system import processor
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.reference import file_calls, variants
from mitsuba_ref.reference.messages import OpenRefusal, OpenRequest, OpenResponse, TraceRequest, TraceResponse
from mitsuba_ref.scene_xml.elements import shape_and_part

SCALAR_RAYS_PER_CHUNK = 16384  # limits memory: a hit takes 500 bytes
CENTER = (0.5, 0.5)  # sample of the aperture or of a light; for points it does not matter

# The type stubs do not cover variants.
mi: Any = mitsuba
dr: Any = drjit

# Optimising, which came with the parser of 3.7, merges meshes and loses their ids.
UNOPTIMISED = {"optimize": False} if hasattr(mi, "parser") else {}


def answer(request: TraceRequest | OpenRequest) -> TraceResponse | OpenResponse | OpenRefusal:
    """The response to a request, computed in this process. Prints nothing.

    Raises RuntimeError with Mitsuba's message where it refuses the scene, or only warns and the request is strict, and
    ImportError where it refuses the variant.
    """
    mi.set_variant(request.variant)
    logger = mi.logger() if hasattr(mi, "logger") else mi.Thread.thread().logger()  # before 3.7
    logger.clear_appenders()  # stdout is for the results of commands
    if isinstance(request, TraceRequest):
        return _trace_request(request, logger)
    logger.set_error_level(mi.LogLevel.Error)
    return file_calls.open_file(request, _sensor_rays)


def _trace_request(request: TraceRequest, logger: Any) -> TraceResponse:
    logger.set_error_level(mi.LogLevel.Warn if request.strict else mi.LogLevel.Error)
    start = time.perf_counter()
    if request.original:
        scene = file_calls.load(OpenRequest(**request.original), request.variant)
    else:
        scene = mi.load_file(str(request.xml), **UNOPTIMISED)
        _restore_ellipsoids(scene)
    arrays, names = _traced(scene, request)
    sensor = np.zeros((0, 7), np.float32)
    if request.sensor and scene.sensors():
        number = request.original["sensor"] if request.original else 0
        sensor = _sensor_rays(scene.sensors()[number], request.variant)
    logger.set_error_level(mi.LogLevel.Error)  # a warning about a mesh file is not one about the scene
    loaded = _meshes(request)
    seconds = time.perf_counter() - start
    if not request.original:
        names = _in_scene_shapes(names, arrays)
    return TraceResponse(names, _versions(request), seconds, sensor=sensor, loaded=loaded, **arrays)


def _restore_ellipsoids(scene: Any) -> None:
    """Semi-axes and quaternions of exported ellipsoids as their attribute `exact` holds them (shapes/sphere.py)."""
    numbers = mi.traverse(scene)
    for name in [key for key, _ in numbers if key.endswith(".exact")]:
        key = name.removesuffix("exact") + "data"
        data = np.array(numbers[key]).reshape(-1, 10)
        data[:, 3:] = np.array(numbers[name]).reshape(-1, 7)
        numbers[key] = type(numbers[key])(data.ravel())
    numbers.update()


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


def _meshes(request: TraceRequest) -> list[tuple[Array, Array, str]]:
    """The request's mesh files as Mitsuba's loader reads them, corner by corner, or its message if it refuses one."""
    loaded: list[tuple[Array, Array, str]] = []
    for file in map(Path, request.mesh_files):
        try:
            mesh = mi.load_dict({"type": file.suffix[1:].lower(), "filename": str(file)})
            faces = file_calls.faces_of(mesh)
            loaded.append((file_calls.vertices_of(mesh)[faces], faces, ""))
        except RuntimeError as error:
            loaded.append((np.zeros((0, 3, 8), np.float32), np.zeros((0, 3), np.int32), str(error)))
    return loaded


def _sensor_rays(sensor: Any, variant: str) -> Array:
    """(n, 7) o, d, t_max through the pixel centres of the crop window, row by row."""
    (x0, y0), (width, height) = sensor.film().crop_offset(), sensor.film().crop_size()
    y, x = (np.ravel(each) for each in np.meshgrid(_centers(y0, height), _centers(x0, width), indexing="ij"))
    aperture, point = mi.Point2f(CENTER), mi.Point2f
    if not variant.startswith("scalar"):
        ray = _sensor_ray(sensor, point(mi.Float(x), mi.Float(y)), aperture)
        return np.column_stack([_rows(values, len(x)) for values in (ray.o, ray.d, ray.maxt)])
    pairs = zip(x.tolist(), y.tolist(), strict=True)
    rays = (_sensor_ray(sensor, point(*pair), aperture) for pair in pairs)
    return np.array([(*ray.o, *ray.d, ray.maxt) for ray in rays], np.float32)


def _sensor_ray(sensor: Any, position: Any, aperture: Any) -> Any:
    """A sensor's ray, or rays, for a position on its film. An irradiancemeter has only those with differentials."""
    try:
        return sensor.sample_ray(0.0, 0.5, position, aperture)[0]
    except RuntimeError:
        return sensor.sample_ray_differential(0.0, 0.5, position, aperture)[0]


def _centers(offset: int, size: int) -> Array:
    """Pixel centres along an axis of a film, rounded as in Mitsuba's integrators.

    fma(offset + k + 1/2, 1/size, -offset/size) in float32; float64 holds the product of two float32 exactly.
    """
    scale = np.float32(1.0) / np.float32(size)
    shift = np.float64(-np.float32(offset) * scale)
    return ((offset + np.arange(size) + 0.5) * np.float64(scale) + shift).astype(np.float32)


def _versions(request: TraceRequest) -> dict[str, str]:
    library = os.environ.get(variants.LIBLLVM_ENVIRONMENT_VARIABLE) if request.variant.startswith("llvm") else None
    return {
        "mitsuba": mi.__version__,
        "drjit": dr.__version__,
        "variant": request.variant,
        "libllvm": library or "none",
        "processor": processor.description(),
    }


# ---- hits


def _traced(scene: Any, request: TraceRequest) -> tuple[dict[str, Any], list[str]]:
    """(the arrays of a TraceResponse with one row per ray, which only hits change; the shapes that they number)."""
    emitters = scene.emitters() if request.lights else None
    if emitters and request.original:
        emitters = sorted(emitters, key=lambda emitter: int(emitter.id()))  # ids are numbers in the file's order
    count, lights = len(request.o), len(emitters or ())
    found: dict[str, Array] = {
        "t": np.full(count, np.inf, np.float32),
        **{name: np.full(count, -1, np.int32) for name in ("shape", "prim")},
        **{name: np.zeros((count, 2), np.float32) for name in ("uv", "prim_uv")},
        **{name: np.zeros((count, 3), np.float32) for name in ("n", "sh_n", "p", "albedo")},
        "origin": np.zeros((0 if request.leaving is None else count, 3), np.float32),
        "light_rgb": np.zeros((lights, count, 3), np.float32),
        "light_visible": np.zeros((lights, count), np.bool_),
    }
    columns = dict(found)
    for k in range(lights):
        columns |= {_RGB % k: found["light_rgb"][k], _VISIBLE % k: found["light_visible"][k]}
    names = {shape.id(): i for i, shape in enumerate(scene.shapes())}
    scalar = request.variant.startswith("scalar") or not count  # LLVM takes no empty arrays
    hits = _scalar_hits if scalar else _llvm_hits
    for rows, values in hits(scene, emitters, request, names):
        for name, column in values.items():
            columns[name][rows] = column
    return found, list(names)


_RGB, _VISIBLE = "light_rgb %d", "light_visible %d"  # of one light


def _values(scene: Any, emitters: list[Any] | None, pi: Any, si: Any, active: Any, leaving: Any) -> dict[str, Any]:
    """Values at one hit, or at those of all rays, of which the `active` ones hit something.

    emitters: None where no light is wanted. leaving: direction of a ray from there, if it is wanted.
    """
    values = {
        "t": si.t,
        "n": si.n,
        "sh_n": si.sh_frame.n,
        "p": si.p,
        "uv": si.uv,
        "prim_uv": pi.prim_uv,
        "prim": si.prim_index,
    }
    if leaving is not None:
        values["origin"] = si.spawn_ray(leaving).o
    if emitters is not None:
        values["albedo"] = si.bsdf().eval_diffuse_reflectance(si, active)
    # The terms that Mitsuba's `direct` integrator sums, with its shadow test kept separate.
    for k, emitter in enumerate(emitters or ()):
        ds, weight = emitter.sample_direction(si, mi.Point2f(CENTER), active)
        values[_RGB % k] = weight * si.bsdf().eval(mi.BSDFContext(), si, si.to_local(ds.d), active)
        shadow = scene.ray_test(si.spawn_ray_to(ds.p), active)  # never true where inactive
        values[_VISIBLE % k] = active ^ shadow
    return values


Hits = Iterator[tuple[Any, dict[str, Array]]]  # rows of rays that hit something, and the values there


def _scalar_hits(scene: Any, emitters: list[Any] | None, request: TraceRequest, names: dict[str, int]) -> Hits:
    def number(si: Any) -> int:
        """The shape's number; in an instance of a user's file, that of the shape in its group, which gets a name."""
        if not si.shape:  # of curves in groups Mitsuba finds hits, but no shape
            return names.setdefault("", len(names))
        if si.instance and request.original:
            return names.setdefault(f"{si.instance.id()}/{si.shape.id()}", len(names))
        return names[(si.instance or si.shape).id()]

    make_ray, intersect, flags = mi.Ray3f, scene.ray_intersect_preliminary, int(mi.RayFlags.All)
    for start in range(0, len(request.o), SCALAR_RAYS_PER_CHUNK):
        chunk = slice(start, start + SCALAR_RAYS_PER_CHUNK)
        numbers = (array[chunk].tolist() for array in (request.o, request.d, request.t_max))
        rows, hits = [], []
        leaving = None if request.leaving is None else request.leaving[chunk].tolist()
        for i, (o, d, t_max) in enumerate(zip(*numbers, strict=True), start):
            ray = make_ray(o, d, t_max, 0.0, [])
            pi = intersect(ray)
            if pi.is_valid():
                si = pi.compute_surface_interaction(ray, flags)
                rows.append(i)
                w = mi.Vector3f(leaving[i - start]) if leaving else None
                hit = _values(scene, emitters, pi, si, True, w) | {"shape": number(si)}
                hits.append(hit if si.shape else hit | {"t": pi.t})
        yield rows, {name: _array_of([hit[name] for hit in hits]) for name in (hits[0] if hits else ())}


def _array_of(values: list[Any]) -> Array:
    """Numbers, or Mitsuba's float32 vectors; converting these one by one takes twenty times as long."""
    if not hasattr(values[0], "__len__"):
        return np.array(values)
    return np.fromiter(chain.from_iterable(values), np.float32).reshape(len(values), -1)


def _llvm_hits(scene: Any, emitters: list[Any] | None, request: TraceRequest, names: dict[str, int]) -> Hits:
    count, ray = len(request.o), vectorised_rays(request.o, request.d, request.t_max)
    pi = scene.ray_intersect_preliminary(ray, coherent=True)  # a hint that changes no bit
    si = pi.compute_surface_interaction(ray, int(mi.RayFlags.All))
    hit = si.is_valid()
    leaving = None if request.leaving is None else mi.Vector3f(_columns(request.leaving))
    values = _values(scene, emitters, pi, si, hit, leaving)
    dr.eval(pi, si, hit, values)
    rows = np.flatnonzero(_rows(hit, count))
    found = {name: _rows(each, count)[rows] for name, each in values.items()}
    yield rows, found | {"shape": _llvm_shapes(scene, si, count)[rows]}


def vectorised_rays(o: Array, d: Array, t_max: Array) -> Any:
    """A ray of arrays: o and d (n, 3), t_max (n,), float32."""
    o, d = mi.Point3f(_columns(o)), mi.Vector3f(_columns(d))
    return mi.Ray3f(o, d, mi.Float(t_max), mi.Float(0.0), mi.Color0f())


def _columns(rows: Array) -> list[Any]:
    return [mi.Float(np.ascontiguousarray(column)) for column in rows.T]


def _llvm_shapes(scene: Any, si: Any, count: int) -> Array:
    """Indices into scene.shapes(). Dr.Jit numbers shapes from 1 in its own order; 0 means no shape."""
    shape, instance = (dr.reinterpret_array(mi.UInt32, pointer) for pointer in (si.shape, si.instance))
    numbers = _rows(dr.select(instance != 0, instance, shape), count)
    known = dr.reinterpret_array(mi.UInt32, scene.shapes_dr()).numpy()
    index = np.full(max(numbers.max(initial=0), known.max(initial=0)) + 1, -1, np.int32)
    index[known] = np.arange(len(known))
    index[0] = -1
    return index[numbers]


def _rows(values: Any, count: int) -> Array:
    """One value or vector for each ray; Dr.Jit keeps a single one where all are equal."""
    array: Array = values.numpy().T
    return np.broadcast_to(array, (count, *array.shape[1:]))

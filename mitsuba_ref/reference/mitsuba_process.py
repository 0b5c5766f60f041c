"""The door to Mitsuba: the only module that imports it, and so the one it may take down with it.

Ask through worker.py, which opens it in a child process.
"""

import os
import time
from pathlib import Path
from typing import Any

import drjit
import mitsuba
import numpy as np

from mitsuba_ref.reference import llvm_rays, scalar_rays, variants
from mitsuba_ref.reference.messages import TraceRequest, TraceResponse

VECTORISED = "llvm"

# Their type stubs know no variants.
mi: Any = mitsuba
dr: Any = drjit


def describe_installation() -> dict[str, Any]:
    """{"variants": those that work here, "libllvm": the path in use, or None}."""
    found = variants.usable_variants()
    return {"variants": list(found.names), "libllvm": found.libllvm}


def trace_request(job: TraceRequest) -> TraceResponse:
    """Load the scene and trace the rays, in this process.

    Raises RuntimeError with Mitsuba's words where it refuses the scene, if the job is strict also where it would
    only warn, and ImportError where it refuses the variant. Prints nothing.
    """
    mi.set_variant(job.variant)
    _set_log_level(job.strict)
    start = time.perf_counter()
    scene = mi.load_file(str(job.xml), optimize=False)  # optimising merges meshes and loses their ids
    arrays: dict[str, Any] = _trace(scene, job) | _sensor_rays(scene, job)
    seconds = time.perf_counter() - start
    names = [shape.id() for shape in scene.shapes()]
    return TraceResponse(names=names, versions=_versions(job.variant), seconds=seconds, **arrays)


def _set_log_level(strict: bool) -> None:
    """Where strict, a warning is an error; and no log on stdout, where answers of commands go."""
    logger = mi.logger()
    logger.clear_appenders()
    logger.set_error_level(mi.LogLevel.Warn if strict else mi.LogLevel.Error)


def _trace(scene: Any, job: TraceRequest) -> dict[str, Any]:
    if job.variant.startswith(VECTORISED) and len(job.o):
        return llvm_rays.trace(mi, dr, scene, job)
    return scalar_rays.trace(mi, scene, job)  # no rays: empty arrays, whatever the variant


def _sensor_rays(scene: Any, job: TraceRequest) -> dict[str, Any]:
    names = ("sensor_o", "sensor_d", "sensor_t_max")
    if not job.sensor or not scene.sensors():
        return dict.fromkeys(names)
    sensor = scene.sensors()[0]
    rays = llvm_rays if job.variant.startswith(VECTORISED) else scalar_rays
    return dict(zip(names, rays.sensor_rays(mi, sensor, *_pixel_centers(sensor.film())), strict=True))


def _pixel_centers(film: Any) -> tuple[np.ndarray, np.ndarray]:
    """x and y across the crop window, row by row, rounded as Mitsuba's integrators round them."""
    (x0, y0), (width, height) = film.crop_offset(), film.crop_size()
    y, x = np.meshgrid(_centers(y0, height), _centers(x0, width), indexing="ij")
    return np.ascontiguousarray(x.ravel()), np.ascontiguousarray(y.ravel())


def _centers(offset: int, size: int) -> np.ndarray:
    """fma(offset + k + 1/2, 1/size, -offset/size) in float32: a product of two is exact in float64."""
    scale = np.float32(1.0) / np.float32(size)
    shift = np.float64(-np.float32(offset) * scale)
    return ((offset + np.arange(size) + 0.5) * np.float64(scale) + shift).astype(np.float32)


def _versions(variant: str) -> dict[str, str]:
    return {
        "mitsuba": mi.__version__,
        "drjit": dr.__version__,
        "variant": variant,
        "libllvm": _libllvm(variant),
    }


def _libllvm(variant: str) -> str:
    """The library that is really loaded, where the system says; or else the one that was asked for."""
    if not variant.startswith(VECTORISED):
        return "none"
    try:
        maps = Path("/proc/self/maps").read_text()
    except OSError:
        return os.environ.get(variants.LIBLLVM_ENVIRONMENT_VARIABLE) or "none"
    return next((line.split()[-1] for line in maps.splitlines() if "libLLVM" in line), "none")

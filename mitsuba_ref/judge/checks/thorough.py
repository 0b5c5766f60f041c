"""Checks of our caster beyond the judged film (`validate --thorough`, `fuzz`): routes and scales."""

import math
from collections.abc import Iterable, Iterator, Mapping
from itertools import cycle
from typing import Any

import numpy as np

from caster.aovs import BY_NAME
from caster.description.errors import SceneError
from caster.geometry.packing import packed
from caster.geometry.world_space import TriangleShape, as_given, is_usable, world_vertices
from caster.rendering.hits import cast, occluded
from caster.rendering.images import camera_rays, evaluate, film_window, render, trace_film
from caster.scene.model import Point, Scene
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.error_model.intersections import LARGEST_COORDINATE, Array
from mitsuba_ref.judge.checks import OURS, Found, bits_differ, check

Arrays = Mapping[str, Array]

ALL = tuple(BY_NAME)
SETS = [*((name,) for name in ALL), ("depth", "normal"), ("uv", "depth"), ("diffuse", "prim_id")]
SIDE = 15  # pixels; an odd number, so that the middle of an edge is a pixel's centre
WIDE = (129, 2)  # one pixel wider than a tile
CROPS = [(0, 0, SIDE, SIDE), (3, 4, 9, 11), (7, 7, 8, 8)]


def different_bits(expected: Arrays, found: Arrays, what: str) -> Iterator[str]:
    """For each array whose bits differ: its name, the number of entries that differ, and the first of them."""
    for name, a in expected.items():
        b = found[name]
        if (a.shape, a.dtype) != (b.shape, b.dtype):
            yield f"{what}: {name}: {a.shape} {a.dtype}, {b.shape} {b.dtype}"
            continue
        differ = np.argwhere(bits_differ(a, b))
        if len(differ):
            at = tuple(int(i) for i in differ[0])
            yield f"{what}: {name}: {len(differ)} of {a.size} differ, first at {at}: {a[at]!r}, {b[at]!r}"


def _whole_film(scene: Scene, width: int, height: int) -> Scene:
    return scene.with_film(width=width, height=height, crop=(0, 0, width, height))


def _result(differences: Iterable[str], looked_at: str) -> Found:
    first = next(iter(differences), "")
    return np.inf if first else 0.0, first or looked_at


# ---- routes ----


@check(of=(OURS,), camera=True, thorough=True)
def check_routes(scene: Scene) -> Found:
    """Every public route to a pixel has to give the bits of the whole image.

    Routes: AOVs, threads, dtypes, crops, testing every primitive, `cast`.
    """
    return _result(route_differences(scene), f"films of {SIDE} x {SIDE} and {WIDE[0]} x {WIDE[1]} pixels")


def route_differences(scene: Scene) -> Iterator[str]:
    """The differences between routes, of small films of the scene."""
    small = _whole_film(scene, SIDE, SIDE)
    whole = render(small, ALL, threads=1)
    for film in (small, _whole_film(scene, *WIDE)):
        image = whole if film is small else render(film, ALL, threads=1)
        for names, threads in zip(SETS, cycle((3, 2, 1)), strict=False):
            expected = {each: image[each] for each in names}
            yield from different_bits(expected, render(film, names, threads=threads), f"{names}, {threads} threads")
    yield from different_bits(render(small, ALL, culling="brute-force"), whole, "planned culling")
    for x0, y0, x1, y1 in CROPS:
        part = small.with_film(crop=(x0, y0, x1, y1))
        cut = {each: whole[each][y0:y1, x0:x1] for each in ALL}
        with np.errstate(over="ignore"):  # float32 has inf there
            rounded = {each: a.astype(np.float32) if a.dtype.kind == "f" else a for each, a in cut.items()}
        yield from different_bits(cut, render(part, ALL), "crop")
        yield from different_bits(rounded, render(part, ALL, dtype=np.float32), "float32")
        traced = evaluate(trace_film(part, threads=1), ALL, film_window(part))
        yield from different_bits(cut, traced, "rays of a crop")
    rays = camera_rays(small)
    if (rays.t_max >= rays.t_min).all():
        yield from _cast_differences(small, {name: aov_rows(whole, name) for name in ALL}, rays)


def _cast_differences(scene: Scene, image: Arrays, rays: Any) -> Iterator[str]:
    """Between the image and its rays cast by `cast` and `occluded`."""
    o, d, t_min, t_max = rays[:4]
    hits = cast(scene, o, d, t_min=t_min, t_max=t_max)
    found = {
        name: getattr(hits, name) for name in ("normal", "shape_id", "prim_id", "position", "shading_normal", "uv")
    }
    found["depth"] = hits.t * np.sqrt(d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1] + d[:, 2] * d[:, 2])
    for arrays in (found, hits.surfaces):
        yield from different_bits({name: image[name] for name in arrays}, arrays, "cast")
    blocked = occluded(scene, o, d, t_max, t_min=t_min)
    yield from different_bits({"hit": np.isfinite(hits.t)}, {"hit": blocked}, "occluded")


# ---- scaling ----

# Fields of cameras that are lengths. t_max counts in lengths of the direction of a camera of type `ray`, which stays.
LENGTHS = ("eye", "look_at", "origin", "near", "far", "width", "t_max")
RATIOS = ("type", "direction", "up", "fov", "fov_axis", "principal_point")
SCALED_AOVS = ("hit", "depth", "position", "normal", "shading_normal", "albedo", "diffuse", "shape_id", "prim_id")
# Far more than thresholds in scene units (1e-6, 1e6) are from the sizes that they are meant for.
POWERS = (-24, 24, 40, -150)
# Products of three lengths have to be normal numbers, even where 2^-120 of them is left by cancellation.
SMALLEST_SIZE_EXPONENT = -300
PACKED_LENGTHS = ("vertices", "center", "radius", "to_world", "point", "start", "end")


@check(of=(OURS,), camera=True, thorough=True)
def check_scaling(scene: Scene) -> Found:
    """Scaling a scene by a power of two has to scale depth and position exactly and to keep all other bits.

    Products, sums, quotients, roots and matrix inverses round alike when their operands are multiplied by powers of
    two, short of overflow and underflow. A threshold in scene units shows as other bits.
    """
    if not {*type(scene.camera).model_fields} <= {*LENGTHS, *RATIOS}:
        return 0.0, "not compared: which fields of the camera are lengths is unknown"
    if not all(type(shape).__module__.startswith("caster.shapes.") for shape in scene.shapes):
        return 0.0, "not compared: whether shapes of plug-ins follow to_world is unknown"
    powers = _powers_of(scene)
    words = f"2^{', 2^'.join(map(str, powers))} times as large" if powers else "not compared: lengths leave float64"
    try:
        return _result(scaling_differences(scene, powers), words)
    except SceneError:  # a camera or a light
        return 0.0, "not compared: lengths leave float64"


def _powers_of(scene: Scene) -> tuple[int, ...]:
    """The powers by which no face is rejected that was not, or the reverse, and no product of lengths underflows."""
    arrays = [array for part in packed(scene).parts for name, array in part._asdict().items() if name in PACKED_LENGTHS]
    sizes = [float(np.abs(array).max(initial=0.0, where=np.isfinite(array))) for array in arrays]
    exponents = [math.frexp(size)[1] for size in sizes if size > 0.0] or [0]
    least = SMALLEST_SIZE_EXPONENT - min(exponents)
    meshes = [shape for shape in scene.shapes if isinstance(shape, TriangleShape)]
    if not all(is_usable(world_vertices(shape.mesh(), shape.matrix, as_given)).all() for shape in meshes):
        least = 0  # smaller, faces that are too large now are hit
    most = math.frexp(LARGEST_COORDINATE)[1] - 2 - max(exponents)
    return tuple(power for power in POWERS if least <= power <= most)


def scaling_differences(scene: Scene, powers: Iterable[int]) -> Iterator[str]:
    """The differences between scales, of a small film of the scene."""
    small = _whole_film(scene, SIDE, SIDE)
    with np.errstate(all="ignore"):  # of kernels in plain Python
        expected = render(small, SCALED_AOVS)
        for power in powers:
            image = render(scaled_scene(small, power), SCALED_AOVS)
            found = {name: np.ldexp(a, -power) if name in ("depth", "position") else a for name, a in image.items()}
            yield from different_bits(_unsigned_zeros(expected), _unsigned_zeros(found), f"scaled by 2^{power}")


def _unsigned_zeros(arrays: Arrays) -> Arrays:
    return {name: a + 0.0 if a.dtype.kind == "f" else a for name, a in arrays.items()}


def scaled_scene(scene: Scene, power: int) -> Scene:
    """The scene 2^power times as large, seen from as many times as far: lights reach it as before."""
    factor = 2.0**power
    lights = []
    for light in scene.lights:
        if isinstance(light, Point):  # it sends factor^2 as much, so that the same arrives
            brighter = {"intensity": np.multiply(factor * factor, light.intensity)}
            light = _with_lengths(light, factor, ("position",)).model_copy(update=brighter)
        lights.append(light)
    shapes = tuple(each.model_copy(update={"to_world": (*each.to_world, {"scale": factor})}) for each in scene.shapes)
    camera = _with_lengths(scene.camera, factor, LENGTHS)
    return scene.model_copy(update={"camera": camera, "lights": tuple(lights), "shapes": shapes})


def _with_lengths(element: Any, factor: float, names: Iterable[str]) -> Any:
    """A copy with the named fields multiplied, those of them that are set."""
    given = {name: getattr(element, name) for name in names if name in type(element).model_fields}
    return element.model_copy(update={name: np.multiply(factor, x) for name, x in given.items() if x is not None})

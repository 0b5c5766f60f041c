"""Checks of our caster beyond the judged film (`validate --thorough`, `fuzz`): routes and scales."""

import math
from collections.abc import Collection, Iterator, Mapping
from itertools import cycle
from typing import Any

import numpy as np

from caster.aovs import BY_NAME
from caster.description.errors import SceneError
from caster.geometry.packing import packed
from caster.geometry.world_space import TriangleShape, as_given, is_usable, world_vertices
from caster.rendering.hits import cast, occluded
from caster.rendering.images import camera_rays, evaluate, film_window, render, trace_film
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.error_model.intersections import LARGEST_COORDINATE, Array
from mitsuba_ref.judge.checks import OURS, Found, bits_differ, check

Arrays = Mapping[str, Array]

ALL = tuple(BY_NAME)
SETS = [*((name,) for name in ALL), ("depth", "normal"), ("uv", "depth"), ("diffuse", "prim_id")]
SIDE = 15  # pixels; an odd number, so that the middle of an edge is a pixel's centre
WIDE = (129, 2)  # one pixel wider than a tile
CROPS = [(0, 0, SIDE, SIDE), (3, 4, 9, 11), (7, 7, 8, 8)]


def different_bits(expected: Arrays, found: Arrays, names: Collection[str], what: str) -> Iterator[Found]:
    """For each named array whose bits differ: its name, the number of entries that differ, and the first of them."""
    for name in names:
        a, b = expected[name], found[name]
        if (a.shape, a.dtype) != (b.shape, b.dtype):
            yield np.inf, f"{what}: {name}: {a.shape} {a.dtype}, {b.shape} {b.dtype}"
            continue
        differ = np.argwhere(bits_differ(a, b))
        if len(differ):
            at = tuple(int(i) for i in differ[0])
            yield np.inf, f"{what}: {name}: {len(differ)} of {a.size} differ, first at {at}: {a[at]!r}, {b[at]!r}"


def _whole_film(scene: Scene, width: int, height: int) -> Scene:
    return scene.with_film(width=width, height=height, crop=(0, 0, width, height))


# ---- routes ----


@check(of=(OURS,), camera=True, thorough=True)
def check_routes(scene: Scene) -> Iterator[Found]:
    """Every public route to a pixel has to give the bits of the whole image, of small films of the scene.

    Routes: AOVs, threads, dtypes, crops, testing every primitive, `cast`.
    """
    small = _whole_film(scene, SIDE, SIDE)
    whole = render(small, ALL, threads=1)
    for film in (small, _whole_film(scene, *WIDE)):
        image = whole if film is small else render(film, ALL, threads=1)
        for names, threads in zip(SETS, cycle((3, 2, 1)), strict=False):
            found = render(film, names, threads=threads)
            yield from different_bits(image, found, names, f"{names}, {threads} threads")
    yield from different_bits(render(small, ALL, culling="brute-force"), whole, ALL, "planned culling")
    for x0, y0, x1, y1 in CROPS:
        part = small.with_film(crop=(x0, y0, x1, y1))
        cut = {each: whole[each][y0:y1, x0:x1] for each in ALL}
        with np.errstate(over="ignore"):  # float32 has inf there
            rounded = {each: a.astype(np.float32) if a.dtype.kind == "f" else a for each, a in cut.items()}
        yield from different_bits(cut, render(part, ALL), ALL, "crop")
        yield from different_bits(rounded, render(part, ALL, dtype=np.float32), ALL, "float32")
        traced = evaluate(trace_film(part, threads=1), ALL, film_window(part))
        yield from different_bits(cut, traced, ALL, "rays of a crop")
    rays = camera_rays(small)
    if (rays.t_max >= rays.t_min).all():
        yield from _cast_differences(small, {name: aov_rows(whole, name) for name in ALL}, rays)
    yield 0.0, f"films of {SIDE} x {SIDE} and {WIDE[0]} x {WIDE[1]} pixels"


def _cast_differences(scene: Scene, image: Arrays, rays: Any) -> Iterator[Found]:
    """Between the image and its rays cast by `cast` and `occluded`."""
    o, d, t_min, t_max = rays[:4]
    hits = cast(scene, o, d, t_min=t_min, t_max=t_max)
    names = ("normal", "shape_id", "prim_id", "position", "shading_normal", "uv")
    found = {name: getattr(hits, name) for name in names}
    found["depth"] = hits.t * np.sqrt(d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1] + d[:, 2] * d[:, 2])
    for arrays in (found, hits.surfaces):
        yield from different_bits(image, arrays, arrays, "cast")
    blocked = occluded(scene, o, d, t_max, t_min=t_min)
    yield from different_bits({"hit": np.isfinite(hits.t)}, {"hit": blocked}, ("hit",), "occluded")


# ---- scaling ----

# Fields of cameras and lights that scale with the scene, with the power of a length that they are: lights send as much
# more as reaches the scene from as many times as far. t_max counts in lengths of the direction of a camera of type
# `ray`, which stays.
LENGTHS = dict.fromkeys(("eye", "look_at", "origin", "near", "far", "width", "t_max", "position"), 1) | {"intensity": 2}
SCALED_AOVS = ("hit", "depth", "position", "normal", "shading_normal", "albedo", "diffuse", "shape_id", "prim_id")
# Far more than thresholds in scene units (1e-6, 1e6) are from the sizes that they are meant for.
POWERS = (-24, 24, 40, -150)
# Products of three lengths have to be normal numbers, even where 2^-120 of them is left by cancellation.
SMALLEST_SIZE_EXPONENT = -300
PACKED_LENGTHS = ("vertices", "center", "radius", "to_world", "point", "start", "end")


@check(of=(OURS,), camera=True, thorough=True)
def check_scaling(scene: Scene) -> Iterator[Found]:
    """Scaling a scene by a power of two has to scale depth and position exactly and to keep all other bits.

    Products, sums, quotients, roots and matrix inverses round alike when their operands are multiplied by powers of
    two, short of overflow and underflow. A threshold in scene units shows as other bits, in a small film.
    """
    if not all(type(each).__module__.startswith("caster.") for each in (scene.camera, *scene.shapes)):
        yield 0.0, "not compared: which numbers of plug-ins are lengths is unknown"
        return
    powers, small = _powers_of(scene), _whole_film(scene, SIDE, SIDE)
    try:
        with np.errstate(all="ignore"):  # of kernels in plain Python
            images = [render(scaled_scene(small, power), SCALED_AOVS) for power in powers]
            expected = {name: a + 0.0 for name, a in render(small, SCALED_AOVS).items()}  # without signs of zeros
    except SceneError:  # a camera or a light
        powers = ()
    if not powers:
        yield 0.0, "not compared: lengths leave float64"
        return
    for power, image in zip(powers, images, strict=True):
        found = {name: (np.ldexp(a, -power) if name in ("depth", "position") else a) + 0.0 for name, a in image.items()}
        yield from different_bits(expected, found, SCALED_AOVS, f"scaled by 2^{power}")
    yield 0.0, f"2^{', 2^'.join(map(str, powers))} times as large"


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


def scaled_scene(scene: Scene, power: int) -> Scene:
    """The scene 2^power times as large, seen from as many times as far: lights reach it as before."""
    larger = {"scale": 2.0**power}
    shapes = tuple(each.model_copy(update={"to_world": (*each.to_world, larger)}) for each in scene.shapes)
    lights = tuple(_scaled(light, power) for light in scene.lights)
    return scene.model_copy(update={"camera": _scaled(scene.camera, power), "lights": lights, "shapes": shapes})


def _scaled(element: Any, power: int) -> Any:
    """A copy with its lengths multiplied by 2^power, those of them that are set."""
    given = {name: getattr(element, name) for name in LENGTHS if name in type(element).model_fields}
    lengths = {name: np.ldexp(x, LENGTHS[name] * power) for name, x in given.items() if x is not None}
    return element.model_copy(update=lengths)

"""Scenes scaled by powers of two: depth scales exactly, everything else keeps its bits.

Products, sums, quotients, roots and matrix inverses round alike when their operands are multiplied by powers of two,
short of overflow and underflow. A threshold in scene units, where ratios of lengths alone may decide, shows as other
bits.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from caster.description.errors import SceneError
from caster.description.fields import Shape
from caster.geometry.packing import packed, rejected_faces
from caster.rendering.images import render
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.error_model.intersections import LARGEST_COORDINATE
from mitsuba_ref.judge.checks import OURS, check
from mitsuba_ref.judge.checks.knife_edges import content_seed
from mitsuba_ref.judge.verdict import SceneCheck

# Of cameras. t_max counts in lengths of the direction of a camera of type `ray`, which stays as long.
CAMERA_LENGTHS = ("eye", "look_at", "origin", "near", "far", "width", "t_max")
CAMERA_RATIOS = ("type", "direction", "up", "fov", "fov_axis", "principal_point")
LENGTHS, RATIOS = (
    ("depth", "position"),
    ("hit", "normal", "shading_normal", "albedo", "diffuse", "shape_id", "prim_id"),
)
COMPARED_AOVS = LENGTHS + RATIOS  # not uv, which are lengths on planes alone

# One exponent below 0 and one above, so large that a threshold in scene units which might be taken for small (1e-4,
# 1e-6) or for large (1e6) does not lie on the same side of all lengths as before. Sizes stay above 2^-300, so that
# products of three of them are normal numbers even where 2^-120 of them is left by cancellation.
SMALLEST_SIZE_EXPONENT = -300
PACKED_LENGTHS = ("vertices", "center", "radius", "to_world", "point")
LEAST_EXPONENT, LARGEST_EXPONENT = 24, 60
WINDOW_SIDE = 24  # pixels of the film's window that are rendered
OUR_SHAPES = "caster.shapes."  # modules of shapes that follow their to_world


def scaled_scene(scene: Scene, exponent: int) -> Scene:
    """The scene 2^exponent times as large, seen from as many times as far: lights reach it as before.

    Raises SceneError where a length leaves float64.
    """
    factor = 2.0**exponent
    return scene.model_copy(
        update={
            "camera": _with_lengths(scene.camera, factor, CAMERA_LENGTHS),
            "lights": tuple(_scaled_light(light, factor) for light in scene.lights),
            "shapes": tuple(_scaled_shape(shape, factor) for shape in scene.shapes),
        }
    )


def _with_lengths(element: Any, factor: float, names: tuple[str, ...]) -> Any:
    """A copy with the named fields multiplied, those of them that are set."""
    given = {name: getattr(element, name) for name in names if name in type(element).model_fields}
    with np.errstate(over="ignore"):  # inf is refused by the description
        lengths = {name: np.multiply(factor, x) for name, x in given.items() if x is not None}
    return element.model_copy(update=lengths)


def _scaled_light(light: Any, factor: float) -> Any:
    """A point light sends factor^2 as much, so that the same arrives; lights without a position stay."""
    if "position" not in type(light).model_fields:
        return light
    moved = _with_lengths(light, factor, ("position",))
    return moved.model_copy(update={"intensity": np.multiply(factor * factor, light.intensity)})


def _scaled_shape(shape: Shape, factor: float) -> Shape:
    return shape.model_copy(update={"to_world": (*shape.to_world, {"scale": factor})})


def unknown_lengths(scene: Scene) -> list[str]:
    """Fields of a plug-in's camera, of which it is unknown whether they are lengths."""
    return sorted(set(type(scene.camera).model_fields) - {*CAMERA_LENGTHS, *CAMERA_RATIOS})


def exponents_of(scene: Scene, seed: int) -> tuple[int, ...]:
    """One exponent below 0 and one above, as far as no face is rejected and no product of three lengths underflows.

    None for a camera of unknown lengths.
    """
    if unknown_lengths(scene):
        return ()
    rng = np.random.default_rng(seed)
    sizes = [
        float(np.abs(array).max(initial=0.0, where=np.isfinite(array)))
        for part in packed(scene).parts
        for name, array in part._asdict().items()
        if name in PACKED_LENGTHS
    ]
    exponents = [math.frexp(size)[1] for size in sizes if size > 0.0] or [0]
    down = min(LARGEST_EXPONENT, min(exponents) - SMALLEST_SIZE_EXPONENT)
    up = min(LARGEST_EXPONENT, math.frexp(LARGEST_COORDINATE)[1] - 2 - max(exponents))
    return tuple(
        sign * int(rng.integers(LEAST_EXPONENT, room + 1))
        for sign, room in ((-1, down), (1, up))
        if room >= LEAST_EXPONENT
    )


class Difference(NamedTuple):
    """Pixels whose bits depend on the scale of the scene."""

    exponent: int
    aov: str
    pixels: np.ndarray  # (n,) rows of the window


def scaling_differences(scene: Scene, exponents: tuple[int, ...]) -> list[Difference]:
    """What differs between the images of the scene and of the scene 2^k times as large, for these k."""
    expected = render(scene, COMPARED_AOVS, threads=1)
    found = []
    for exponent in exponents:
        other = render(scaled_scene(scene, exponent), COMPARED_AOVS, threads=1)
        for name in COMPARED_AOVS:
            power = exponent if name in LENGTHS else 0
            differs = _bits_differ_scaled(aov_rows(expected, name), aov_rows(other, name), power)
            found += [Difference(exponent, name, np.flatnonzero(differs))] if differs.any() else []
    return found


@check(of=(OURS,), thorough=True)
def check_scaling(scene: Scene) -> SceneCheck:
    """A window of the image of the scene at other scales: the same bits, lengths times 2^k."""
    unknown = unknown_lengths(scene)
    if unknown or not scene.shapes:
        what = f"camera {unknown[0]}: unknown whether a length" if unknown else "no shape to scale"
        return SceneCheck("scaling", 0.0, what)
    seed = content_seed(packed(scene))
    exponents = exponents_of(scene, seed)
    if not exponents:
        return SceneCheck("scaling", 0.0, "not compared: at another scale lengths or their products leave float64")
    part = scene.with_film(crop=_random_window(np.random.default_rng(seed), scene.film.window))
    try:
        different = scaling_differences(part, exponents)
    except SceneError:
        return SceneCheck("scaling", 0.0, f"outside float64 2^{exponents} times as large")
    if different and any(each.too_large for each in rejected_faces(scene).values()):
        exponents = tuple(exponent for exponent in exponents if exponent > 0)  # smaller, such faces are hit
        different = [each for each in different if each.exponent > 0]
    if not different:
        what = " and ".join(f"2^{exponent}" for exponent in exponents)
        return SceneCheck(
            "scaling", 0.0, f"the scene {what} times as large" if what else "not compared: faces too far out"
        )
    if still := _shapes_that_stay(scene):
        return SceneCheck("scaling", 0.0, f"{still[0]} does not follow its to_world")
    x0, y0, x1, _ = part.film.window
    exponent, aov, pixels = different[0]
    x, y = x0 + int(pixels[0]) % (x1 - x0), y0 + int(pixels[0]) // (x1 - x0)
    what = f"{aov} at ({x}, {y}) and {len(pixels) - 1} more pixels: other bits 2^{exponent} times as large"
    return SceneCheck("scaling", np.inf, what)


def _shapes_that_stay(scene: Scene) -> list[str]:
    """Names of shapes from elsewhere whose packed numbers are the same twice as large: they may ignore to_world.

    None of the caster's own does; one that stays where it is, as a plane through the origin, excuses no difference.
    """
    parts, doubled = packed(scene).parts, packed(scaled_scene(scene, 1)).parts
    return [
        name
        for name, shape, part, other in zip(scene.shape_names(), scene.shapes, parts, doubled, strict=True)
        if not type(shape).__module__.startswith(OUR_SHAPES)
        and type(part) is type(other)
        and all(map(np.array_equal, part, other))
    ]


def _random_window(rng: np.random.Generator, window: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    x0, y0, x1, y1 = window
    left, top = (int(rng.integers(max(1, side - WINDOW_SIDE + 1))) for side in (x1 - x0, y1 - y0))
    return x0 + left, y0 + top, min(x1, x0 + left + WINDOW_SIDE), min(y1, y0 + top + WINDOW_SIDE)


def _bits_differ_scaled(expected: np.ndarray, found: np.ndarray, exponent: int) -> np.ndarray:
    """(n,) bool: rows whose bits differ, lengths brought back by 2^-exponent; zeros may have either sign."""
    if found.dtype.kind == "f" and exponent:
        found = np.ldexp(found, -exponent)
    a, b = (rows.reshape(len(rows), -1) for rows in (expected, found))
    if a.dtype.kind == "f":
        a, b = a + 0.0, b + 0.0
    kind = f"u{a.itemsize}"
    different: np.ndarray = (np.ascontiguousarray(a).view(kind) != np.ascontiguousarray(b).view(kind)).any(axis=1)
    return different

"""Checks of shapes by independent computations: placement, packed numbers, material; which shapes are judged."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from caster.geometry.packing import Packed, packed
from caster.scene.model import Diffuse, Scene
from mitsuba_ref.error_model.independent_transform import ExpectedNumbers, transform_error_ratio
from mitsuba_ref.error_model.intersections import without_overflow_warnings
from mitsuba_ref.error_model.tolerances import TRANSFORM_ROUNDINGS
from mitsuba_ref.judge.adjudication import ratio_to_bound
from mitsuba_ref.judge.checks import OURS, Found, check
from mitsuba_ref.reference.originals import original_of
from mitsuba_ref.reference.shared_input import packed_float32
from mitsuba_ref.shapes import kind_of, reference_of


@check()
def check_placement(scene: Scene) -> Iterator[Found]:
    """Compare each shape's matrix with an independent composition of its steps."""
    for name, shape in zip(scene.shape_names(), scene.shapes, strict=True):
        if shape.to_world:
            yield transform_error_ratio(shape), f"to_world of {name}"


# How a scene is packed, by the type that its numbers are rounded to: for `render`, and for the comparison.
PACKINGS: dict[str, Callable[[Scene], Packed]] = {"float64": packed, "float32": packed_float32}


@check()
def check_geometry(scene: Scene) -> Iterator[Found]:
    """Compare each shape's packed numbers, float64 and float32, with an independent computation."""
    for number, (name, shape) in enumerate(zip(scene.shape_names(), scene.shapes, strict=True)):
        for precision, packing in PACKINGS.items():
            part = packing(scene).parts[number]
            for field in unrounded_arrays(part, precision):
                yield np.inf, f"{field} of {name} not rounded to {precision}"
            for claim in reference_of(shape).expected(shape, part):
                yield _packing_error_ratio(claim, np.finfo(precision)), f"{claim.what} of {name} ({precision})"


@without_overflow_warnings
def unrounded_arrays(part: Any, dtype: str) -> list[str]:
    """Arrays of a packed shape that hold numbers which were not rounded to a type.

    Both sides have to trace rounded numbers. No bound shows if they were not: float64 lies within float32's bounds.
    """
    derived = kind_of(part).derived
    floats = {name: array for name, array in part._asdict().items() if array.dtype.kind == "f" and name not in derived}
    return [name for name, array in floats.items() if not np.array_equal(array, array.astype(dtype))]


def _packing_error_ratio(claim: ExpectedNumbers, numbers: np.finfo[Any]) -> float:
    """Largest error over its bound; inf if the shape of the array differs.

    Below the smallest normal number, the spacing of numbers is constant, and a rounding error is at most half of it.
    """
    if claim.packed.shape != np.shape(claim.expected):
        return float("inf")
    error = np.abs(claim.packed - claim.expected)
    size = np.maximum(claim.size, float(numbers.tiny)) if claim.rounded else claim.size
    bound = TRANSFORM_ROUNDINGS * float(numbers.eps) / 2.0 * np.broadcast_to(size, error.shape)
    return float(ratio_to_bound(error, bound).max(initial=0.0))  # the direction of normals that cancel has no bound


@check(of=(OURS,))
def check_materials(scene: Scene) -> Iterator[Found]:
    """Check that each shape's material is the one it names; Mitsuba gets the material that the caster looks up."""
    for name, shape in zip(scene.shape_names(), scene.shapes, strict=True):
        named = scene.materials[shape.material] if shape.material else Diffuse()
        yield 0.0 if scene.material_of(shape) == named else np.inf, f"material of {name}"


@check()
def check_coverage(scene: Scene) -> Found | None:
    """Require that every shape of a Mitsuba file is judged, if the run is strict."""
    original = original_of(scene)
    if original is None:
        return None
    covered = original.coverage
    ratio = np.inf if covered.strict and covered.partial else 0.0
    return ratio, "; ".join([covered.brief or f"all {covered.shapes} shapes", *covered.left_out])

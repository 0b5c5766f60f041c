"""What is checked once for each shape of a scene: where it stands, the numbers it packs to, and its material."""

from typing import NamedTuple

import numpy as np

from caster.description.fields import Shape
from caster.geometry.packing import pack
from caster.geometry.world_space import Rounding, as_float32, as_given
from caster.scene.materials import Diffuse
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import error_over_bound
from mitsuba_ref.error_model.independent_transform import ExpectedNumbers, transform_error_ratio
from mitsuba_ref.error_model.scene_model import reference_of
from mitsuba_ref.error_model.tolerances import TRANSFORM_ROUNDINGS
from mitsuba_ref.judge.scene_checks.scene_check import Shares
from mitsuba_ref.judge.verdict import SceneCheck


def check_placement(scene: Scene) -> SceneCheck:
    """Each shape's matrix against its steps, composed a second time."""
    ratios = [transform_error_ratio(shape) for shape in scene.shapes if shape.to_world]
    names = [name for name, shape in zip(scene.shape_names(), scene.shapes, strict=True) if shape.to_world]
    if not ratios:
        return SceneCheck("placement", 0.0, "no shape has a to_world")
    worst = int(np.argmax(ratios))
    return SceneCheck("placement", ratios[worst], f"to_world of {names[worst]}")


class Precision(NamedTuple):
    """How the numbers of a shape are rounded when it is packed."""

    name: str
    rounded: Rounding
    unit_roundoff: float
    # Below it the spacing of numbers stays what it is there, and so does what a rounding may take: half of it, the
    # unit round-off of the smallest normal number.
    smallest_normal: float


PRECISIONS = (
    Precision("float64", as_given, 2.0**-53, 2.0**-1022),  # what `render` casts
    Precision("float32", as_float32, 2.0**-24, 2.0**-126),  # what is judged against the reference
)


def check_geometry(scene: Scene) -> SceneCheck:
    """Each shape's numbers in the world, float64 and float32, against its description, worked out a second time."""
    shares = Shares()
    for precision in PRECISIONS:
        parts = pack(scene, precision.rounded).parts
        for name, shape, part in zip(scene.shape_names(), scene.shapes, parts, strict=True):
            for claim in reference_of(shape).expected(shape, part):
                share = _packing_error_ratio(claim, precision.unit_roundoff, precision.smallest_normal)
                shares.add(f"{claim.what} of {name} ({precision.name})", share)
    worst, share = shares.worst()
    return SceneCheck("geometry", share, worst)


def _packing_error_ratio(claim: ExpectedNumbers, rounding: float, normal: float) -> float:
    """Largest error over its bound; inf where there are other numbers than expected."""
    if claim.packed.shape != np.shape(claim.expected):
        return float("inf")
    error = np.abs(claim.packed - claim.expected)
    size = np.maximum(claim.size, normal) if claim.rounded else claim.size
    bound = TRANSFORM_ROUNDINGS * rounding * np.broadcast_to(size, error.shape)
    hopeless = np.isposinf(bound)  # normals that cancel: their direction is undefined
    return float(np.where(hopeless, 0.0, error_over_bound(error, bound)).max(initial=0.0))


def check_materials(scene: Scene) -> SceneCheck:
    """Each shape's material is the one it names: Mitsuba gets what the caster looks up."""
    ratios = [
        0.0 if scene.material_of(shape) == _described_material(scene, shape) else np.inf
        for shape in scene.shapes
    ]
    if not ratios:
        return SceneCheck("materials", 0.0, "no shape")
    worst = int(np.argmax(ratios))
    return SceneCheck("materials", ratios[worst], f"material of {scene.shape_names()[worst]}")


def _described_material(scene: Scene, shape: Shape) -> Diffuse:
    return scene.materials[shape.material] if shape.material else Diffuse()

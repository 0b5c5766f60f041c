"""What is checked once for each shape of a scene: where it stands, the numbers it packs to, and its material."""

import numpy as np

from caster.fields import Shape
from caster.materials import Diffuse
from caster.packing import pack
from caster.placing import as_float32, as_given
from caster.scene import Scene
from mitsuba_ref.model import reference_of
from mitsuba_ref.pixels import share_of_bound
from mitsuba_ref.placed import Claim
from mitsuba_ref.placement import disagreement
from mitsuba_ref.scene_check import SceneCheck


def check_placement(scene: Scene) -> SceneCheck:
    """Each shape's matrix against its steps, composed a second time."""
    ratios = [disagreement(shape) for shape in scene.shapes if shape.to_world]
    names = [name for name, shape in zip(scene.shape_names(), scene.shapes, strict=True) if shape.to_world]
    if not ratios:
        return SceneCheck("placement", 0.0, "no shape has a to_world")
    worst = int(np.argmax(ratios))
    return SceneCheck("placement", ratios[worst], f"to_world of {names[worst]}")


# A packed number is a dot product and a sum, or a normal made of two of them and its length: a dozen roundings. In
# float32 it is rounded once more.
PLACED_ROUNDINGS = 16.0

# (which numbers, unit round-off, smallest normal number). Below the latter the spacing of numbers stays what it is
# there, and so does what a rounding may take: half of it, the round-off of the smallest normal number.
ROUNDINGS = (
    (as_given, 2.0**-53, 2.0**-1022),
    (as_float32, 2.0**-24, 2.0**-126),
)


def check_geometry(scene: Scene) -> SceneCheck:
    """Each shape's numbers in the world, float64 and float32, against its description, worked out a second time."""
    shares = {
        f"{claim.what} of {name}": _share_of_claim(claim, rounding, normal)
        for rounded, rounding, normal in ROUNDINGS
        for name, shape, part in zip(
            scene.shape_names(), scene.shapes, pack(scene, rounded).parts, strict=True
        )
        for claim in reference_of(shape).placed(shape, part)
    }
    worst = max(shares, key=lambda what: shares[what], default="nothing to look at")
    return SceneCheck("geometry", shares.get(worst, 0.0), worst)


def _share_of_claim(claim: Claim, rounding: float, normal: float) -> float:
    """Largest error over its bound; inf where there are other numbers than expected."""
    if claim.packed.shape != np.shape(claim.expected):
        return float("inf")
    error = np.abs(claim.packed - claim.expected)
    size = np.maximum(claim.size, normal) if claim.rounded else claim.size
    bound = PLACED_ROUNDINGS * rounding * np.broadcast_to(size, error.shape)
    hopeless = np.isposinf(bound)  # normals that cancel: nobody knows where they point
    return float(np.where(hopeless, 0.0, share_of_bound(error, bound)).max(initial=0.0))


def check_materials(scene: Scene) -> SceneCheck:
    """Each shape's material is the one it names: Mitsuba is told what the caster looks up."""
    ratios = [
        0.0 if scene.material_of(shape) == _material_of(scene, shape) else np.inf for shape in scene.shapes
    ]
    if not ratios:
        return SceneCheck("materials", 0.0, "no shape")
    worst = int(np.argmax(ratios))
    return SceneCheck("materials", ratios[worst], f"material of {scene.shape_names()[worst]}")


def _material_of(scene: Scene, shape: Shape) -> Diffuse:
    return scene.materials[shape.material] if shape.material else Diffuse()

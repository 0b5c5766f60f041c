"""The judge's side of coin_plugin.py."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from coin_plugin import Coin, Coins, Scanner

from caster.scene.model import Film
from caster.shapes.disk import Disks
from mitsuba_ref import cameras
from mitsuba_ref.cameras.camera_reference import CameraReference, camera_axes, eye_origins
from mitsuba_ref.error_model.defect_conditions import GRAZED_FLAT, STARTS_ON_FLAT, DefectView, abs_cosine
from mitsuba_ref.error_model.independent_transform import ExpectedNumbers, up_to_rounding
from mitsuba_ref.error_model.intersections import ErrorModel, Intersections, Rays, by_normal
from mitsuba_ref.oracle.exact_numbers import IntegerRay, Integers3, Root, shifted, sub
from mitsuba_ref.oracle.interface import ExactKind, Roots, boxes_around
from mitsuba_ref.scene_xml.elements import ShapeWriter, XmlElement
from mitsuba_ref.shapes import disk, register
from mitsuba_ref.shapes.shape_reference import Fields, PrimitiveReference, ShapeReference
from mitsuba_ref.shapes.targets import Rng, SurfacePoints, random_length, random_point


def to_xml(out: ShapeWriter, shape: Coin, part: Coins) -> list[XmlElement]:
    """Mitsuba's unit disk under a uniform scale."""
    return out.native(shape, "disk", part.center, part.radius[:, None, None] * np.eye(3))


def expected_coin(shape: Coin, part: Coins) -> Iterator[ExpectedNumbers]:
    yield up_to_rounding("center", part.center[0], shape.center)
    yield up_to_rounding("radius", part.radius[0], shape.radius)


# ---- the error model: that of Mitsuba's disk


def as_disks(prims: Coins) -> Disks:
    r = prims.radius[:, None, None]
    return Disks(prims.center, r * np.eye(3), np.eye(3) / r)


def intersect(prims: Coins, k: np.ndarray, o: np.ndarray, d: np.ndarray, ku: float) -> tuple[Intersections, ...]:
    return disk.intersect(as_disks(prims), k, o, d, ku)


# ---- exact arithmetic: every number a whole number times a power of two


def vectors(prims: Coins, k: Any) -> np.ndarray:
    """The centre, and the radius three times."""
    return np.stack([prims.center[k], prims.radius[k, None].repeat(3, axis=-1)], axis=-2)


def intersect_exactly(coin: Sequence[Integers3], bits: int, ray: IntegerRay) -> Roots:
    """t = f.z / d.z for f from the origin to the centre; there, x^2 + y^2 against r^2, all times d.z^2."""
    center, (radius, *_) = (shifted(v, bits) for v in coin)
    f = sub(center, ray.o)
    if not ray.d[2]:
        return ()
    x, y = (f[2] * ray.d[i] - f[i] * ray.d[2] for i in (0, 1))
    beyond = x * x + y * y - (radius * ray.d[2]) ** 2
    if beyond > 0:
        return ()
    return ((Root(f[2], 0, 0, ray.d[2], ray.e), "inside" if beyond else "rim"),)


def boxes(prims: Coins) -> tuple[np.ndarray, np.ndarray]:
    """Rounded outwards."""
    return boxes_around(prims.center, prims.radius[:, None] * np.array([1.0, 1.0, 0.0]))


# ---- what the fuzzer draws and aims at, what reproducers write, what Mitsuba is known to get wrong


def random_fields(rng: Rng, lattice: bool) -> Fields:
    return {"center": random_point(rng, lattice), "radius": random_length(rng, lattice)}


def surface_points(prims: Coins, k: np.ndarray, rng: Rng, sort: str) -> SurfacePoints:
    return disk.DISKS.surface_points(as_disks(prims), k, rng, sort)


def describe(part: Coins, k: int) -> Fields:
    return {"type": "coin", "center": part.center[k].tolist(), "radius": float(part.radius[k])}


def defect_view(prims: Any, k: int, o: np.ndarray, d: np.ndarray, t: float) -> DefectView:
    return DefectView(cosine=abs_cosine(np.array([0.0, 0.0, 1.0]), d))


COINS = PrimitiveReference(
    Coins,
    ErrorModel(intersect, ExactKind(boxes, vectors, intersect_exactly), uv=disk.UV),
    describe,
    surface_points,
    rounding_groups=(by_normal,),
    known_defects=(STARTS_ON_FLAT, GRAZED_FLAT),
    defect_view=defect_view,
)
register(ShapeReference(Coin, to_xml, (COINS,), expected_coin, random_fields, groups=("flat", "small"), analytic=True))


def scanner_rays(camera: Scanner, film: Film, x: np.ndarray, y: np.ndarray) -> Rays:
    """Parallel, from a grid around the eye."""
    right, up, forward = camera_axes(camera)
    across, above = camera.spacing * (x - film.width / 2.0), camera.spacing * (film.height / 2.0 - y)
    o = eye_origins(camera, len(x)) + np.outer(across, right) + np.outer(above, up)
    return Rays(o, np.tile(forward, (len(x), 1)), np.zeros(len(x)), np.full(len(x), np.inf))


cameras.register(CameraReference(Scanner, scanner_rays))

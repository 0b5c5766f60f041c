"""Conditions under which Mitsuba 3.9.1 is known to be wrong: measurements at a pixel, and thresholds on them.

Each kind of primitive declares its own defects (`PrimitiveReference.known_defects`); those shared by several kinds are
here. Their numbers are the rows of docs/internals/edge-cases.md. The conditions are so tight that a wrong image of an
ordinary surface meets none of them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from mitsuba_ref.error_model.intersections import Array

# Errors up to this many times the bounds of docs/method.md still count as rounding, though worse than it should be.
WIDENED_BOUNDS_FACTOR = 16.0

NEARLY_EDGE_ON_COSINE = 2.0**-6  # |cos|, 0.9 degrees
GRAZING_COSINE = 2.0**-10  # |cos|, 0.06 degrees
SLIVER_HEIGHT_RATIO = 2.0**-13  # height over longest edge
COLLINEAR_HEIGHT_RATIO = 2.0**-20  # height over longest edge
FAR_IN_SIZES = 2.0**13  # sizes
SQUASHED_STRETCH = 2.0**6  # lengths of the direction in object space
ALONG_AXIS_SINE = 2.0**-6  # sine


class DefectView(NamedTuple):
    """Measurements of a ray and a t at one primitive; the defaults meet no condition."""

    cosine: float = 1.0  # |cos| between the ray and the normal of a flat primitive
    slenderness: float = 1.0  # least height of a triangle over its longest edge
    axis_angle: float = 1.0  # sine of the angle between the ray and an axis
    stretch: float = 1.0  # length of the direction in object space
    beyond_corners: bool = False  # t is beyond the farthest corner of a triangle, or before the nearest
    without_area: bool = False  # a triangle has no area, exactly
    starts_inside: bool = False  # the ray starts within a curve of the scene, or up to rounding on it


@dataclass(frozen=True)
class DefectFeatures:
    """A pixel where the reference is wrong. Kinds are names of primitive kinds, such as "Triangles"; "" for a miss."""

    ours: str  # kind that is hit, exactly and by the caster
    theirs: str  # kind that the reference names
    where: frozenset[str]  # "inside", "edge" ... of the members of the exact tie set
    t: float  # of the reference, inf on a miss
    # a primitive of the named shape is hit at t = 0: exactly, or up to rounding for a stand-in
    at_zero: bool
    # the smaller of both sides' primitives; beyond_corners and without_area: of the reference's alone
    cosine: float
    beyond_corners: bool
    without_area: bool
    slenderness: float
    distance: float  # from the ray's origin to the primitive in question, in its sizes
    offset: float  # the primitive's largest coordinate, in its sizes
    axis_angle: float
    stretch: float  # the larger of both
    nearly: bool  # bounds WIDENED_BOUNDS_FACTOR times as wide would allow the reference's answer
    # its normal is NaN where rounding allows one of length 0, and apart from that it is `nearly`
    normless: bool = False
    robust: bool = True  # Embree's mode; without it, `nearly` allows a miss between two faces
    starts_inside: bool = False  # of either


class KnownDefect(NamedTuple):
    """One way in which the reference is known to be wrong about a kind of primitive."""

    number: int
    name: str
    priority: int  # if several conditions hold, the defect with the lowest number here is reported
    condition: Callable[[DefectFeatures], bool]
    # whether the kind is hit exactly and another or none is named by the reference, or is named, or is hit or named
    subject: Literal["missed", "named", "either"] = "either"


def starts_on_surface(m: DefectFeatures) -> bool:
    return m.at_zero and m.t == 0.0


def far_from_origin(m: DefectFeatures) -> bool:
    return m.offset > FAR_IN_SIZES and m.nearly


def small_and_far(m: DefectFeatures) -> bool:
    return m.distance > FAR_IN_SIZES and m.nearly


NAN_T = KnownDefect(27, "a t that is not a number, from a denormal slope", 0, lambda m: m.t != m.t)
STARTS_ON_FLAT = KnownDefect(
    30,
    "a ray that starts on a flat surface, or within rounding of the patch for a plane: Mitsuba reports a hit at t = 0",
    1,
    starts_on_surface,
    "named",
)
STARTS_ON_CURVED = KnownDefect(
    7, "a ray that starts on a sphere or a cylinder: Mitsuba reports a hit at t = 0", 2, starts_on_surface, "named"
)
GRAZED_FLAT = KnownDefect(
    43, "a disk or a plane at grazing incidence", 13, lambda m: m.cosine < GRAZING_COSINE and m.nearly
)
STRETCHED = KnownDefect(
    8,
    "a squashed ellipsoid: Mitsuba assumes a direction of length 1 in object space, which it is far from",
    15,
    lambda m: m.stretch > SQUASHED_STRETCH and m.nearly,
)


def abs_cosine(n: Array, d: Array) -> float:
    """|cos| of the angle between two vectors; 1 where one has no length."""
    lengths = float(np.linalg.norm(n) * np.linalg.norm(d))
    return abs(float(n @ d)) / lengths if lengths > 0.0 else 1.0

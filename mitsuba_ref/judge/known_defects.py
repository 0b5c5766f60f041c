"""Where Mitsuba 3.9.1 is known to be wrong: each case by its number, in words, and by what a pixel of it is like.

The numbers are those of a catalogue of 77 hard cases of ray casting; only the ones that Mitsuba fails are here. A case
says what must be measured at a pixel, so tightly that a wrong picture of an ordinary surface fits none.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple


@dataclass(frozen=True)
class DefectFeatures:
    """A pixel where the reference is wrong. `kind`s are names of packed arrays, such as Triangles; "" for a miss."""

    ours: str  # kind that is hit, by exact arithmetic as by us
    theirs: str  # kind of what the reference says is hit
    where: frozenset[str]  # of the members of the exact tie set
    flags: frozenset[str]  # of the exact answer
    t: float  # of the reference, inf on a miss
    # a primitive of the shape it names is met at t = 0: exactly, or if a patch stands in for it, up to its rounding
    at_zero: bool
    cosine: (
        float  # |cos| between the ray and the normal of the primitive in question, the least of both sides'
    )
    beyond_corners: (
        bool  # its t is beyond the farthest corner of the triangle it names, or before the nearest
    )
    without_area: bool  # the triangle it names has no area, exactly
    slenderness: float  # least height of the triangle in question over its longest edge; 1 for other kinds
    distance: float  # from the ray's origin to the primitive in question, in its sizes
    offset: float  # the primitive's largest coordinate, in its sizes
    axis_angle: float  # sine of the angle between the ray and a cylinder's axis; 1 for other kinds
    stretch: float  # length of the ray's direction as the unit shape of an ellipsoid or cylinder sees it; 1 otherwise
    nearly: bool  # bounds SLACK times as wide would allow the reference's answer
    # its normal is no number, may be one of length 0 as far as rounding goes, and but for that it is `nearly`
    normless: bool = False

    @property
    def kinds(self) -> frozenset[str]:
        return frozenset({self.ours, self.theirs} - {""})

    @property
    def missed(self) -> bool:
        """The reference does not see what is there."""
        return self.ours != "" and self.theirs != self.ours

    def about(self, *kinds: str) -> bool:
        """Whether one of these kinds is hit by either side."""
        return bool(self.kinds & set(kinds))


# Rounding that is worse than the bounds of docs/method.md, yet rounding: what they allow when widened so much.
WIDENED_BOUNDS_FACTOR = 16.0

NEARLY_EDGE_ON_COSINE = 2.0**-6  # |cos|, 0.9 degrees
GRAZING_COSINE = 2.0**-10  # |cos|, 0.06 degrees
SLIVER_HEIGHT_RATIO = 2.0**-13  # height over longest edge
FAR_IN_SIZES = 2.0**13  # sizes
SQUASHED_STRETCH = 2.0**6  # lengths of the direction as the unit shape sees it
ALONG_AXIS_SINE = 2.0**-6  # sine

TRIANGLES, PLANES, DISKS = "Triangles", "Planes", "Disks"
SPHERES, ELLIPSOIDS, CYLINDERS = "Spheres", "Ellipsoids", "Cylinders"
QUADRICS = (SPHERES, ELLIPSOIDS, CYLINDERS)


class KnownDefect(NamedTuple):
    """One way in which the reference is known to be wrong."""

    number: int
    name: str
    fits: Callable[[DefectFeatures], bool]


KNOWN_DEFECTS = (
    KnownDefect(27, "a t that is not a number, from a denormal slope", lambda m: m.t != m.t),
    KnownDefect(
        30,
        "a ray that starts on a flat surface, or on the patch for a plane, up to its rounding: Mitsuba says that it is "
        "hit at t = 0",
        lambda m: m.at_zero and m.t == 0.0 and m.theirs in (TRIANGLES, PLANES, DISKS),
    ),
    KnownDefect(
        7,
        "a ray that starts on a ball or a tube: Mitsuba says that it is hit at t = 0",
        lambda m: m.at_zero and m.t == 0.0 and m.theirs in QUADRICS,
    ),
    KnownDefect(
        21,
        "a triangle without any area that Embree's robust mode hits all the same",
        lambda m: m.theirs == TRIANGLES and m.without_area,
    ),
    KnownDefect(
        28,
        "a triangle nearly edge-on: Embree's robust mode lets a ray in beyond an edge and gives a t beyond the corners",
        lambda m: m.theirs == TRIANGLES and m.beyond_corners and m.cosine < NEARLY_EDGE_ON_COSINE,
    ),
    KnownDefect(
        4,
        "a ball that a ray touches in one point, exactly: Mitsuba misses it",
        lambda m: m.missed and "tangent" in m.where and m.ours in (SPHERES, ELLIPSOIDS),
    ),
    KnownDefect(
        55,
        "a tube that a ray touches along its wall, exactly",
        lambda m: m.missed and "tangent" in m.where and m.ours == CYLINDERS,
    ),
    KnownDefect(
        16,
        "a ray through the corner of a mesh, exactly: Embree's robust mode lets some slip through",
        lambda m: m.missed and m.ours == TRIANGLES and "vertex" in m.where,
    ),
    KnownDefect(
        45,
        "a ray through the rim of a disk, exactly",
        lambda m: m.missed and m.ours == DISKS and "rim" in m.where,
    ),
    KnownDefect(
        56,
        "a ray through the end of a tube, exactly",
        lambda m: m.missed and m.ours == CYLINDERS and "rim" in m.where,
    ),
    KnownDefect(
        22,
        "a triangle of three corners in a line but for their rounding",
        lambda m: m.about(TRIANGLES) and m.slenderness < 2.0**-20 and m.nearly,
    ),
    KnownDefect(
        19,
        "a sliver of a triangle",
        lambda m: m.about(TRIANGLES) and m.slenderness < SLIVER_HEIGHT_RATIO and m.nearly,
    ),
    KnownDefect(
        26,
        "a triangle that a ray grazes",
        lambda m: m.about(TRIANGLES) and m.cosine < GRAZING_COSINE and m.nearly,
    ),
    KnownDefect(
        43,
        "a disk or a plane that a ray grazes",
        lambda m: m.about(DISKS, PLANES) and m.cosine < GRAZING_COSINE and m.nearly,
    ),
    KnownDefect(
        53,
        "a tube that a ray passes nearly along its axis",
        lambda m: m.about(CYLINDERS) and m.axis_angle < ALONG_AXIS_SINE and m.nearly,
    ),
    KnownDefect(
        8,
        "a squashed ball: its unit shape sees a direction that is far from length 1, which Mitsuba takes for 1",
        lambda m: m.about(ELLIPSOIDS, CYLINDERS) and m.stretch > SQUASHED_STRETCH and m.nearly,
    ),
    KnownDefect(
        57,
        "a tube that is thin and far away",
        lambda m: m.about(CYLINDERS) and m.distance > FAR_IN_SIZES and m.nearly,
    ),
    KnownDefect(
        2,
        "a ball that is small and far away",
        lambda m: m.about(SPHERES, ELLIPSOIDS) and m.distance > FAR_IN_SIZES and m.nearly,
    ),
    KnownDefect(
        35,
        "a triangle that is small and far away",
        lambda m: m.about(TRIANGLES) and m.distance > FAR_IN_SIZES and m.nearly,
    ),
    KnownDefect(
        9,
        "a ball far from the origin; one so far that it is lost in the rounding of its centre has no normal there",
        lambda m: m.about(SPHERES, ELLIPSOIDS) and m.offset > FAR_IN_SIZES and (m.nearly or m.normless),
    ),
    KnownDefect(
        34,
        "a triangle far from the origin",
        lambda m: m.about(TRIANGLES) and m.offset > FAR_IN_SIZES and m.nearly,
    ),
    KnownDefect(
        47, "a disk far from the origin", lambda m: m.about(DISKS) and m.offset > FAR_IN_SIZES and m.nearly
    ),
    KnownDefect(
        61,
        "a tube far from the origin",
        lambda m: m.about(CYLINDERS) and m.offset > FAR_IN_SIZES and m.nearly,
    ),
)
DEFECT_NAMES = {case.number: case.name for case in KNOWN_DEFECTS}


def case_of(measured: DefectFeatures) -> int | None:
    """The number of the first case that fits; None: the reference is wrong in a way that is not listed."""
    return next((case.number for case in KNOWN_DEFECTS if case.fits(measured)), None)

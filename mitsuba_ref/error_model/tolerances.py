"""Tolerances with derivations: K, which all bounds are multiples of, and those of checks, diagnosis and EXR files."""

import math
from dataclasses import dataclass

from caster.description.errors import SceneError

# Unit round-off of float32, in which Mitsuba computes.
U32 = 2.0**-24

# Mitsuba's answer is accepted where it is the exact answer to numbers perturbed by at most K u each. The largest K
# that t needed on any measured ray inside the domain is 2.8 (docs/method.md, "Measured"); a typical ray needs 0.1.
K = 4.0
KU = K * U32

# The same for a caster in float64, as ours is; twice, because what it is compared with is computed in float64 too.
KU_OURS = 2.0 * K * 2.0**-53

# Means of groups whose signs are tosses of a coin give |z| >= x with a probability of at most 2 exp(-x^2 / 2),
# however many and however large they are (Hoeffding): 7.5e-6 for 5. No |z| exceeds the root of the number of groups.
LARGEST_Z = 5.0
MIN_GROUPS = int(LARGEST_Z**2) + 1  # with fewer, no bias whatever could fail

# Where normals are not bounded any closer than this, float32 is of no use for the pixel: an angle of 3.6 degrees.
LARGEST_USEFUL_NORMAL_ERROR = 2.0**-4

# A hypothesis of the diagnosis is reported where it predicts the number to this share of itself: far beyond rounding
# in float32, far below any of the faults that are distinguished. No pixel passes or fails by it; the check
# `ray_conventions` fails where most rays of one length are off by more, and nearly all of length 1 are not.
MATCH_RTOL = 1e-4
DISTINCT_RTOL = 10 * MATCH_RTOL  # two numbers that are so far apart are not alike
MAJORITY = 0.5  # what is reported of all wrong t at once has to be true of more of them than this

# A wrong pixel becomes right under a hypothesis within twice its bound: what a hypothesis predicts carries the rounding
# of one more pixel (a fitted constant) or of one more operation of d (a length), which K roundings of each number
# cover. Or where a hundredth of the error is left, of a caster that has lost digits beside. No pixel passes or fails by
# these.
FIT_FACTOR, LARGEST_RESIDUAL = 2.0, 0.01
NEARLY_ALL = 0.9  # of the wrong pixels: a hypothesis that explains so many is the cause, and no other is looked for
MIN_FITTED_PIXELS = 3  # from which a constant is fitted: one is always fitted, a second may be alike

# A separator is reported where one threshold has so many of the wrong pixels on one side, and of the right ones on the
# other. k of the j pixels on one side are wrong by chance, of m wrong among n, with a probability below
# exp(-j KL(k / j || m / n)) (Hoeffding 1963, which holds for draws without replacement, too); times the number of
# thresholds and features tried, that has to stay below this.
SEPARATES = 0.95
SEPARATOR_CHANCE = 1e-6

# Scene check `camera`: a direction goes through an orthobasis (three unit vectors of 4 roundings each), a position on
# the film (4), a sine or tangent (2) of an angle of up to pi, and a length (3): 32 roundings on either side, in steps
# of KU_OURS, which is K roundings on either side.
CAMERA_ROUNDINGS = 8.0

# Scene check `geometry`: a packed number is a dot product and a sum, or a normal made of two of them and its length: a
# dozen roundings. In float32 it is rounded once more.
TRANSFORM_ROUNDINGS = 16.0

# The same check, of spheres: a matrix counts as a similarity while its Gram matrix is, up to 128 roundings; any other
# makes an ellipsoid.
SIMILARITY_ROUNDINGS = 128.0 + TRANSFORM_ROUNDINGS

# Scene check `mesh_files`, against Mitsuba's loader, in float32: a normal is rounded as it is parsed and made unit, by
# 3 squares, 2 sums, a root and a quotient; of a number of up to 1 that is at most 8 U. A v of uv is rounded, and once
# more where it is turned over.
FILE_NORMAL_ROUNDINGS, FILE_UV_ROUNDINGS = 8.0, 2.0

# ---- comparison of two EXR files ----

DEPTH_RTOL = K * U32 * 3
"""Of depth, where no condition is known: S / t = 3 (S = |o| + t + |p|) when ray origin and hit lie within one
depth of the world's origin, at normal incidence. Farther away or grazing needs the condition, or --depth-rtol."""

NORMAL_ATOL = K * U32 * (8 + 1)
"""Of a flat normal: K u (|Q|/|N| + 1), Q the permanent of the edges' cross product N. |Q|/|N| is at most
2 / sin(corner), below 8 for corners from 15 to 165 degrees; a thinner sliver needs --normal-atol."""

COLOR_RTOL = 16 * U32
"""Of a colour: a Lambert term is at most 16 rounded operations (difference, square, root, dot, products)."""

TYPICAL_ATOL = K * U32
"""Of a colour or uv, times the reference's typical value: cos(n, light) near 0 and the barycentric sum lose
digits against their full size, not against their result. Typical is the median of what is not 0: one
highlight, however bright, must not loosen the rest."""

LARGEST_FIRST_ORDER_SHARE = 0.5
"""A first-order error of this share of the value or more bounds nothing: the plain bound holds there."""


# A half has 11 bits, and below 2^-14 the spacing stays 2^-24. It was rounded once as it was stored, and where depth was
# made into a distance, a second time.
HALF_ROUNDINGS = 2.0
U_HALF, SMALLEST_HALF = 2.0**-11, 2.0**-24


@dataclass(frozen=True)
class Tolerances:
    """What may differ. None: the derived bound; a number replaces it: |error| <= rtol |reference| + atol.

    depth_rtol also holds for positions; color_* for every channel that is not geometry.
    max_pixels: how many pixels may differ (never by NaN or inf). ignore: groups or channel patterns left out.
    allow_empty: two images that hit nothing pass. other_scene: so may two of different scenes, by their attributes.
    """

    depth_rtol: float | None = None
    normal_atol: float | None = None
    uv_atol: float | None = None
    color_rtol: float | None = None
    color_atol: float | None = None
    max_pixels: int = 0
    ignore: tuple[str, ...] = ()
    allow_empty: bool = False
    other_scene: bool = False

    def __post_init__(self) -> None:
        for name in ("depth_rtol", "normal_atol", "uv_atol", "color_rtol", "color_atol", "max_pixels"):
            value = getattr(self, name)
            if value is not None and not 0 <= value < math.inf:
                raise SceneError(f"--{name.replace('_', '-')}: expected a number >= 0, got {value}")

"""All tolerances, with derivations: K, the unit of all bounds, and those of checks, diagnosis and EXR comparison."""

import math
from dataclasses import dataclass

from caster.description.errors import SceneError

# Unit round-off of float32, in which Mitsuba computes.
U32 = 2.0**-24

# Mitsuba's answer is accepted if it is the exact answer for inputs perturbed by at most K u each. The largest K that t
# needed on any measured ray inside the domain is 2.8 (docs/method.md, "Measured"); a typical ray needs 0.1.
K = 4.0
KU = K * U32

# The arithmetic of 3.9.1 was read, and its errors and defects were measured. With the other versions all shipped scenes
# and those of the fuzzer pass within the same bounds (docs/internals/versions.md). Any other is named in the summary.
MEASURED_FOR = {
    "mitsuba": ("3.6.0", "3.6.4", "3.7.0", "3.7.1", "3.8.0", "3.9.0", "3.9.1"),
    "variant": ("scalar_rgb", "llvm_ad_rgb"),
}

# K u for a float64 caster such as ours; doubled, because its answer is compared with one computed in float64.
KU_OURS = 2.0 * K * 2.0**-53

# Mitsuba 3.9.1 decodes the 256 bytes of sRGB by an approximation of the power 2.4, each off by at most 41.8 roundings
# of its value; half as many more for processors with other fused operations.
SRGB_DECODING_ROUNDINGS = 63.0

# Barycentrics by Cramer's rule from the edges u, v and x = p - a: 5 roundings each of the products u u, u v, v v, u x,
# v x (two differences of numbers that are given, a product, two sums), 12 of the numerator, 12 of the determinant, a
# division or an approximate reciprocal with 2: 26 u, or 6.5 K u.
BARYCENTRIC_ROUNDINGS = 7.0

# If the signs of group means are random, |z| >= x has a probability of at most 2 exp(-x^2 / 2), however many groups
# there are and however large (Hoeffding): 7.5e-6 for x = 5. |z| is at most the square root of the number of groups.
LARGEST_Z = 5.0
MIN_GROUPS = int(LARGEST_Z**2) + 1  # with fewer groups, no bias could fail

# Scene check `t_bias`: a candidate's t may be off by the same number of roundings u t on every ray, since estimated
# reciprocals and roots are off to one side. On x86 their relative error e is at most 1.5 2^-12, and one Newton step
# makes it e^2 (a reciprocal) or 1.5 e^2 (the reciprocal of a root). Denominators that differ between faces are spread
# over the table, within whose cells e is linear: a third of the largest e^2 on average, 0.75 u. Lengths of unit
# directions are all near 1, where e is 2^-12: 1 u of a reciprocal, 1.5 u of a root. A rounded factor adds 0.5 u.
LARGEST_T_BIAS = 0.75 + 1.0 + 1.5 + 0.5
BIASED_PIXELS = 1 << 16  # of a film, evenly spaced, that are looked at

# If the bound on a normal is larger than this (3.6 degrees), float32 says nothing useful about the pixel.
LARGEST_USEFUL_NORMAL_ERROR = 2.0**-4

# A hypothesis of the diagnosis fits a number that it predicts to this relative error: far beyond float32 rounding, far
# below any fault to be distinguished. No pixel passes or fails by it. The check `ray_conventions` fails if most rays of
# one length are off by more, and nearly all rays of length 1 are not.
MATCH_RTOL = 1e-4
DISTINCT_RTOL = 10 * MATCH_RTOL  # two numbers this far apart are different
MAJORITY = 0.5  # a statement about all wrong t must hold for a larger fraction than this

# A hypothesis explains a wrong pixel if its prediction is within twice the bound there: the prediction carries the
# rounding of one more pixel (a fitted constant) or of one more operation on d (a length), which K roundings of each
# number cover; or if a hundredth of the error remains, for casters that lose digits for another reason as well. No
# pixel passes or fails by these.
FIT_FACTOR, LARGEST_RESIDUAL = 2.0, 0.01
NEARLY_ALL = 0.9  # a hypothesis that explains this fraction of the wrong pixels is the cause; no other is tried
# Rounding in float32 makes errors of 0.02 to 0.2 of its bound, and rounding in float64 of 2^-29 of these. A caster
# computes in float32 if the median is above this.
LEAST_FLOAT32_ERROR = 2.0**-10
# A fit that leaves a larger median than this share of the bound leaves more than rounding, which makes up to 0.2.
MORE_THAN_ROUNDING = 0.25
MIN_FITTED_PIXELS = 3  # to fit a constant: one pixel always fits, and two may be alike

# A separator is a threshold with this fraction of the wrong pixels on one side, and of the right ones on the other.
# If m of n pixels are wrong, k of j pixels on one side are wrong by chance with a probability below
# exp(-j KL(k / j || m / n)) (Hoeffding 1963, also for draws without replacement). Times the number of thresholds and
# features tried, it must stay below SEPARATOR_CHANCE.
SEPARATES = 0.95
SEPARATOR_CHANCE = 1e-6

# Scene check `camera`: a direction takes the roundings of an orthobasis (three unit vectors, 4 each), of a position on
# the film (4), of a sine or tangent (2) of an angle up to pi, and of a length (3): 32 on either side, in units of
# KU_OURS, which is K roundings on either side.
CAMERA_ROUNDINGS = 8.0

# Scene check `geometry`: a packed number is a dot product and a sum, or a normal made of two of these and its length: a
# dozen roundings, and one more in float32.
TRANSFORM_ROUNDINGS = 16.0

# The same check, for spheres: a matrix is a similarity if its Gram matrix is a multiple of the identity up to 128
# roundings; otherwise the sphere becomes an ellipsoid.
SIMILARITY_ROUNDINGS = 128.0 + TRANSFORM_ROUNDINGS

# Scene check `mesh_files`, against Mitsuba's float32 loader: a normal is rounded when parsed and normalised, by 3
# squares, 2 sums, a root and a quotient; for components of at most 1, at most 8 U. v of uv is rounded once, and once
# more where it is flipped.
FILE_NORMAL_ROUNDINGS, FILE_UV_ROUNDINGS = 8.0, 2.0

# ---- comparison of two EXR files ----

DEPTH_RTOL = K * U32 * 3
"""Relative tolerance of depth if no condition is known: S / t = 3 (S = |o| + t + |p|) when ray origin and hit lie
within one depth of the world's origin, at normal incidence. Farther away or grazing needs the condition, or
--depth-rtol."""

NORMAL_ATOL = K * U32 * (8 + 1)
"""Absolute tolerance of a flat normal: K u (|Q|/|N| + 1), Q the permanent of the edges' cross product N. |Q|/|N| is at
most 2 / sin(corner), below 8 for corners from 15 to 165 degrees; a thinner sliver needs --normal-atol."""

COLOR_RTOL = 16 * U32
"""Relative tolerance of a colour: a Lambert term takes at most 16 rounded operations."""

TYPICAL_ATOL = K * U32
"""Absolute tolerance of a colour or uv, in units of the image's typical value: cos(n, light) near 0 and the barycentric
sum are rounded relative to their terms, not to their result. Typical is the median of the values other than 0, so that
one bright highlight does not loosen the rest."""

LARGEST_FIRST_ORDER_SHARE = 0.5
"""Beyond this relative size, a first-order error estimate bounds nothing, and the plain bound is used."""


# A half has 11 significant bits, and a spacing of 2^-24 below 2^-14. Values are rounded once when stored, and a second
# time where depth is converted to distance.
HALF_ROUNDINGS = 2.0
U_HALF, SMALLEST_HALF = 2.0**-11, 2.0**-24


@dataclass(frozen=True)
class Tolerances:
    """Tolerances of an EXR comparison. None: the derived bound; else |error| <= rtol |reference| + atol.

    depth_rtol also applies to positions; color_* to every channel that is not geometry.
    max_pixels: how many pixels may differ (never by NaN or inf). ignore: groups or channel patterns to leave out.
    other_scene: images of different scenes, by their attributes, may be compared.
    """

    depth_rtol: float | None = None
    normal_atol: float | None = None
    uv_atol: float | None = None
    color_rtol: float | None = None
    color_atol: float | None = None
    max_pixels: int = 0
    ignore: tuple[str, ...] = ()
    other_scene: bool = False

    def __post_init__(self) -> None:
        for name in ("depth_rtol", "normal_atol", "uv_atol", "color_rtol", "color_atol", "max_pixels"):
            value = getattr(self, name)
            if value is not None and not 0 <= value < math.inf:
                raise SceneError(f"--{name.replace('_', '-')}: expected a number >= 0, got {value}")

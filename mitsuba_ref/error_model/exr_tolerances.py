"""Tolerances of the comparison of two EXR files, each with its derivation."""

import math
from dataclasses import dataclass

from caster.description.errors import SceneError
from mitsuba_ref.error_model.intersections import K, U

DEPTH_RTOL = K * U * 3
"""Of depth, where no condition is known: S / t = 3 (S = |o| + t + |p|) when ray origin and hit lie within one
depth of the world's origin, seen head on. Farther away or grazing needs the condition, or --depth-rtol."""

NORMAL_ATOL = K * U * (8 + 1)
"""Of a flat normal: K u (|Q|/|N| + 1), Q the permanent of the edges' cross product N. |Q|/|N| is at most
2 / sin(corner), below 8 for corners from 15 to 165 degrees; a thinner sliver needs --normal-atol."""

COLOR_RTOL = 16 * U
"""Of a colour: a Lambert term is at most 16 rounded operations (difference, square, root, dot, products)."""

TYPICAL_ATOL = K * U
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

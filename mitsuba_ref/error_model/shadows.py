"""Lit or in shadow: which of the two each side may answer (docs/method.md, "Shadows").

Mitsuba starts its shadow rays off the surface and stops them short of the light; a feature thinner than that is lit
through. So it is judged along its own ray, as its source has it, and ours along the straight way to the light.
"""

from typing import NamedTuple

import numpy as np

from mitsuba_ref.error_model.bracket import Bracket
from mitsuba_ref.error_model.intersections import KU_OURS, U, dot, norm
from mitsuba_ref.error_model.lambert import LightContribution, ShadingPoints

# Mitsuba 3.9.1, math.h: how far off the surface a ray starts, in units of 1 + max |p|, and by which share of its
# length a ray to a light stops short.
RAY_EPSILON = 1500 * U
SHADOW_EPSILON = 10 * RAY_EPSILON


class ShadowRays(NamedTuple):
    """Shadow rays."""

    o: np.ndarray  # (m, 3)
    d: np.ndarray  # (m, 3)
    t_max: np.ndarray  # (m,)


def reference_shadow_rays(
    hit: ShadingPoints, lit: LightContribution, p: np.ndarray, n: np.ndarray
) -> ShadowRays:
    """From Mitsuba's own p (m, 3), moved along its normal n to the light's side, to just before the light."""
    near = np.isfinite(lit.reach)
    way = np.where(near[:, None], hit.p + lit.to_light - p, lit.to_light)
    offset = (1.0 + np.abs(p).max(axis=1)) * RAY_EPSILON
    o = p + (np.copysign(offset, dot(n, way)))[:, None] * n
    d = np.where(near[:, None], p + way - o, way)
    return ShadowRays(o, d, np.where(near, 1.0 - SHADOW_EPSILON, np.inf))


def reference_visibility(
    bracket: Bracket, hit: ShadingPoints, lit: LightContribution, p: np.ndarray, n: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(may be lit, may be in shadow), (m,) bool each; p, n: Mitsuba's position and normal (both are checked, too)."""
    possible, certain = bracket.blocked(*reference_shadow_rays(hit, lit, p, n))
    return ~certain, possible


def our_visibility(
    bracket: Bracket, hit: ShadingPoints, lit: LightContribution, prim: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same for ours, from the point that was hit; the primitive there does not shadow itself at its start.

    That point is o + t d, so it lies off the surface by what the sum rounds.
    """
    off = KU_OURS * (norm(hit.p) + norm(hit.d) * np.abs(hit.at.t))
    possible, certain = bracket.blocked(hit.p, lit.to_light, lit.reach, leaving=(prim, off))
    return ~certain, possible

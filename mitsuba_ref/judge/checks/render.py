"""Check of our caster: the image that `render` gives users, against the rays that are judged."""

from dataclasses import replace
from typing import Any

import numpy as np

from caster.aovs import Aovs
from caster.geometry.packing import packed
from caster.rendering.hits import RayHits, trace, trace_rays
from caster.rendering.images import camera_rays, evaluate, film_window, render
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import aov_rows, intersections_at
from mitsuba_ref.error_model.bracket import Bracket, Claims
from mitsuba_ref.error_model.intersections import Array, Rays, any_of_columns, norm
from mitsuba_ref.error_model.scene_model import OUR_SIDE
from mitsuba_ref.error_model.textures import ColoredPoints, color_ratios
from mitsuba_ref.error_model.tolerances import KU_OURS
from mitsuba_ref.judge.adjudication import sample_rows
from mitsuba_ref.judge.checks import OURS, Found, bits_differ, check, worst_pixel
from mitsuba_ref.judge.diffuse import diffuse_within_float64, shading_points
from mitsuba_ref.reference.shared_input import SharedRays, model_of

# `render`, which is what users get, against the rays that are judged.
#
# Judged rays start at the near plane and have no least t; those of `render` start in the eye. With a near plane they
# are other rays, by the rounding of where the near plane is, which is as large as the last digit of the eye's
# coordinates. And judged rays are rounded to float32, so d is not of unit length: spheres are then evaluated by
# `surface`, and not by the vectors that `render` has for unit rays. So `render` is also compared with hits on rays with
# d of twice the length, and where bits differ it is held to its own rays: to what the float64 bracket allows there,
# with no room for the move.


CHECKED_AOVS = ("depth", "normal", "shading_normal", "position", "uv", "shape_id", "diffuse", "prim_id", "albedo")
RENDER_PIXELS_CHECKED = 4096  # pixels that are judged where bits may differ: a few tenths of a second
# The same where no near plane moves the rays: 1024 pixels miss a fault of one pixel in a hundred with probability 3e-5.
UNMOVED_PIXELS_CHECKED = 1024


@check(of=(OURS,), scope="window", camera=True)
def check_render(scene: Scene) -> Found:
    """Compare the image of `render` with the camera's rays cast through trees, and with the rays that are judged.

    The former have to give the same bits, the latter the same bits or values that float64's bounds allow.
    """
    rays, window = camera_rays(scene), film_window(scene)
    ours = render(scene, CHECKED_AOVS)
    cast = trace_rays(scene, packed(scene), rays, np.zeros(len(rays.o)))
    differs = _differs(ours, evaluate(cast, CHECKED_AOVS, window))
    if differs.any():
        return _worst(scene, "bits of the same ray cast by itself", differs)
    moved = bool((rays.t_min > 0.0).any())
    if moved:
        left = np.where(rays.t_max < 0.0, -1.0, rays.t_max - rays.t_min)
        cast = trace(scene, rays.o + rays.t_min[:, None] * rays.d, rays.d, left, rays.t_min)
    differs = _differs(ours, evaluate(_by_longer_rays(cast), CHECKED_AOVS, window))
    rows = np.flatnonzero(differs)
    differing = len(rows)
    if differing:
        rows = sample_rows(rows, RENDER_PIXELS_CHECKED if moved else UNMOVED_PIXELS_CHECKED)
        differs[:] = False
        differs[rows] = ~_within_float64(scene, ours, rows, rays)
    ratio, what = _worst(scene, "pixel", differs)
    sampled = f"; {len(rows)} of {differing} pixels with other bits looked at" if len(rows) < differing else ""
    return ratio, what + sampled


def _differs(ours: Aovs, others: Aovs) -> Array:
    """(n,) bool: pixels where some AOV has other bits."""
    pixels = len(aov_rows(ours, "depth"))
    differs = [any_of_columns(bits_differ(ours[name], others[name]).reshape(pixels, -1)) for name in CHECKED_AOVS]
    return np.any(differs, axis=0)


def _worst(scene: Scene, what: str, differs: Array) -> Found:
    return worst_pixel({what: np.where(differs, np.inf, 0.0)}, scene)


def _by_longer_rays(view: RayHits) -> RayHits:
    """The same hits on rays with d of twice the length and half of t."""
    rays, nearest = view.rays, view.nearest
    return replace(
        view,
        rays=rays._replace(d=2.0 * rays.d, t_min=0.5 * rays.t_min, t_max=0.5 * rays.t_max),
        nearest=nearest._replace(t=0.5 * nearest.t),
        start=0.5 * view.start,
    )


def _within_float64(scene: Scene, ours: Aovs, rows: Array, rays: Any) -> Array:
    """(m,) bool: at these rows, geometry is in float64's bracket, and diffuse as the lights' definitions give it."""
    rays = Rays(*rays[:4]).take(rows)
    depth, n, sh_n, p, uv, shape, diffuse, prim, albedo = (aov_rows(ours, name)[rows] for name in CHECKED_AOVS)
    t = depth / norm(rays.d)
    model = model_of(scene, SharedRays(rays.o, rays.d, rays.t_max, np.zeros(len(t))), packed(scene))
    bracket = Bracket(model, OUR_SIDE)
    claims = Claims(t, shape, n, sh_n, p, KU_OURS * t, uv=uv)
    found = bracket.judge(rays, claims)
    right = found.allowed | found.open
    colored = ColoredPoints(shape, prim, uv, p, albedo)
    right &= color_ratios(scene.textures, model.packed.parts, colored, KU_OURS) <= 1.0
    hit = np.flatnonzero(right & (shape >= 0))
    o, d, t, shape = rays.o[hit], rays.d[hit], t[hit], shape[hit]
    prim = model.packed.first[shape] + prim[hit]
    at = intersections_at(model, prim, o, d, t, OUR_SIDE)
    points = shading_points(scene, o + t[:, None] * d, d, at, shape, albedo[hit])
    right[hit] &= diffuse_within_float64(scene, points, prim, diffuse[hit], bracket)
    return right

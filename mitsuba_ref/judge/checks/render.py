"""Checks of our caster: what `render` gives users against the way that pixels are judged, and both without culling."""

from dataclasses import replace
from typing import Any

import numpy as np

from caster.aovs import Aovs
from caster.geometry.packing import packed
from caster.geometry.world_space import as_given
from caster.rendering.casting import find_nearest
from caster.rendering.hits import RayHits, trace, trace_rays
from caster.rendering.images import camera_rays, evaluate, film_window, render
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import aov_rows, nearest_root
from mitsuba_ref.error_model.bracket import Bracket, Claims, RaySegments
from mitsuba_ref.error_model.intersections import any_of_columns, norm
from mitsuba_ref.error_model.lambert import ShadingPoints
from mitsuba_ref.error_model.tolerances import KU_OURS
from mitsuba_ref.judge.checks import OURS, check, worst_pixel
from mitsuba_ref.judge.diffuse import diffuse_within_float64
from mitsuba_ref.judge.verdict import SceneCheck
from mitsuba_ref.reference.shared_input import SharedRays, model_of


def bits_differ(a: Aovs, b: Aovs, name: str) -> np.ndarray:
    """(n,) bool: pixels where one AOV of two images has other bits."""
    rows, others = aov_rows(a, name), aov_rows(b, name)
    different = rows.view(f"u{rows.itemsize}") != others.view(f"u{rows.itemsize}")
    return different if different.ndim == 1 else any_of_columns(different)


# `render`, which is what users get, against the way that pixels are judged.
#
# Judged rays start at the near plane and have no least t; those of `render` start in the eye. With a near plane they
# are other rays, by the rounding of where the near plane is, which is as large as the last digit of the eye's
# coordinates. And judged rays are rounded to float32, so d is not of unit length: spheres are then evaluated by
# `surface`, and not by the vectors that `render` has for unit rays. So `render` is compared with hits on rays with d of
# twice the length, and where bits differ it is held to its own rays: to what the float64 bracket allows there, with no
# room for the move.


CHECKED_AOVS = ("depth", "normal", "shading_normal", "position", "uv", "shape_id", "diffuse", "prim_id")
RENDER_PIXELS_CHECKED = 4096  # pixels that are judged where bits may differ: a few tenths of a second
# The same where no near plane moves the rays: 1024 pixels miss a fault of one pixel in a hundred with probability 3e-5.
UNMOVED_PIXELS_CHECKED = 1024


@check(of=(OURS,), scope="window", camera=True)
def check_render(scene: Scene) -> SceneCheck:
    """What `render` gives is what the judged rays give: the same bits, or where they cannot be, right by float64."""
    rays = camera_rays(scene)
    moved = bool((rays.t_min > 0.0).any())
    o = rays.o + rays.t_min[:, None] * rays.d
    left = np.where(rays.t_max < 0.0, -1.0, rays.t_max - rays.t_min)
    judged = _by_longer_rays(trace(scene, o, rays.d, left, rays.t_min, rounded=as_given))
    ours, theirs = render(scene, CHECKED_AOVS), evaluate(judged, CHECKED_AOVS, film_window(scene))
    differs = np.any([bits_differ(ours, theirs, name) for name in CHECKED_AOVS], axis=0)
    rows = np.flatnonzero(differs)
    differing, most = len(rows), RENDER_PIXELS_CHECKED if moved else UNMOVED_PIXELS_CHECKED
    if differing:
        rows = np.random.default_rng(1).choice(rows, min(most, differing), replace=False)
        differs[:] = False
        differs[rows] = ~_within_float64(scene, ours, rows, _segments(rays, rows))
    found = worst_pixel("render", {"pixel": np.where(differs, np.inf, 0.0)}, np.ones(len(o), bool), scene)
    sampled = f"; {len(rows)} of {differing} pixels with other bits looked at" if len(rows) < differing else ""
    return replace(found, what=found.what + sampled)


def _by_longer_rays(view: RayHits) -> RayHits:
    """The same hits on rays with d of twice the length and half of t."""
    rays, nearest = view.rays, view.nearest
    return replace(
        view,
        rays=rays._replace(d=2.0 * rays.d, t_min=0.5 * rays.t_min, t_max=0.5 * rays.t_max),
        nearest=nearest._replace(t=0.5 * nearest.t),
        start=0.5 * view.start,
    )


def _segments(rays: Any, rows: np.ndarray) -> RaySegments:
    """Some of the camera's rays."""
    return RaySegments(rays.o[rows], rays.d[rows], rays.t_min[rows], rays.t_max[rows])


def _within_float64(scene: Scene, ours: Aovs, rows: np.ndarray, rays: RaySegments) -> np.ndarray:
    """(m,) bool: geometry within float64's bracket, diffuse as the lights' definitions give it there."""
    depth, n, sh_n, p, uv, shape, diffuse, prim = (aov_rows(ours, name)[rows] for name in CHECKED_AOVS)
    t = depth / norm(rays.d)
    model = model_of(scene, packed(scene), SharedRays(rays.o, rays.d, rays.t_max, np.zeros(len(t))))
    bracket = Bracket(model, KU_OURS, ours=True)
    claims = Claims(t, shape, n, sh_n, p, KU_OURS * t, uv=uv)
    found = bracket.judge(rays.o, rays.d, rays.t_max, claims, t_min=rays.t_min)
    right = found.allowed | found.open
    hit = np.flatnonzero(right & (shape >= 0))
    o, d, t, shape = rays.o[hit], rays.d[hit], t[hit], shape[hit]
    prim = model.packed.first[shape] + prim[hit]
    at = nearest_root(model.intersect(prim, o, d, KU_OURS, ours=True), t)
    right[hit] &= diffuse_within_float64(
        scene, ShadingPoints(o + t[:, None] * d, d, shape, at), prim, diffuse[hit], bracket
    )
    return right


BRUTE_FORCE_TESTS = 1 << 24  # rays times primitives that are tried without any culling


@check(of=(OURS,), scope="window", camera=True)
def check_culling(scene: Scene) -> SceneCheck:
    """`render`, as it is planned for this scene, against the way that pixels are judged: the same bits."""
    rays = camera_rays(scene)
    judged = trace_rays(scene, packed(scene), rays, np.zeros(len(rays.o)))
    planned = render(scene, CHECKED_AOVS)
    tree = evaluate(judged, CHECKED_AOVS, film_window(scene))
    differs = np.any([bits_differ(planned, tree, name) for name in CHECKED_AOVS], axis=0)
    return _same_bits("culling", differs, scene)


@check(of=(OURS,), scope="window", camera=True, thorough=True)
def check_brute_force(scene: Scene) -> SceneCheck:
    """The way that pixels are judged against every primitive there is, on a sample of rays: the same bits."""
    rays, numbers = camera_rays(scene), packed(scene)
    rows = _sampled_rays(len(rays.o), int(numbers.first[-1]))
    obvious = find_nearest(numbers, type(rays)(*(a[rows] for a in rays)), "brute-force")
    found, differs = find_nearest(numbers, rays), np.zeros(len(rays.o), bool)
    differs[rows] = (obvious.t != found.t[rows]) | (obvious.prim != found.prim[rows])
    return _same_bits("brute_force", differs, scene)


def _same_bits(name: str, differs: np.ndarray, scene: Scene) -> SceneCheck:
    """A check that allows no difference; differs: (n,) bool, of the window's pixels."""
    return worst_pixel(name, {"bits": np.where(differs, np.inf, 0.0)}, np.ones(len(differs), bool), scene)


def _sampled_rays(rays: int, prims: int) -> np.ndarray:
    """Some rays, spread by a fixed seed: at least 64, as far as there are as many."""
    count = min(rays, max(64, BRUTE_FORCE_TESTS // max(prims, 1)))
    return np.sort(np.random.default_rng(1).choice(rays, count, replace=False))

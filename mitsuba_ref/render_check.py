"""`render`, which is what users get, against the way that pixels are judged.

Judged rays start at the near plane and have no least t; those of `render` start in the eye. Without a near plane the
two are the same rays, and check_culling demands the same bits. With one they are others, by the rounding of where the
near plane is, which is as large as the last digit of the eye's coordinates. So where bits differ, `render` is held to
its own rays, from the eye, with their least t: what the float64 bracket allows there, with no room for the move.
"""

from typing import Any

import numpy as np

from caster.hits import trace
from caster.packing import pack
from caster.placing import as_given
from caster.rendering import Aovs, camera_rays, evaluate, film_window, render
from caster.scene import Scene
from mitsuba_ref.bounds import nearest_root
from mitsuba_ref.bracket import Bracket, Claims, Line
from mitsuba_ref.lambert import Hit
from mitsuba_ref.meeting import KU_OURS, norm
from mitsuba_ref.model import model_of
from mitsuba_ref.pixels import flat
from mitsuba_ref.rays import SharedRays
from mitsuba_ref.scene_check import SceneCheck, bits_differ, worst_of
from mitsuba_ref.shading import right_in_float64

NAMES = ("depth", "normal", "shading_normal", "position", "shape_id", "diffuse", "prim_id")
SAMPLE = 4096  # pixels that are judged where bits may differ: a few tenths of a second


def check_render(scene: Scene) -> SceneCheck:
    """What `render` gives is what the judged rays give: the same bits, or where they cannot be, right by float64."""
    rays = camera_rays(scene)
    if not (rays.t_min > 0.0).any():
        return SceneCheck("render", 0.0, "no near plane: the rays are those that culling is checked on")
    o = rays.o + rays.t_min[:, None] * rays.d
    left = np.where(rays.t_max < 0.0, -1.0, rays.t_max - rays.t_min)
    judged = trace(scene, o, rays.d, left, rays.t_min, rounded=as_given)
    ours, moved = render(scene, NAMES), evaluate(judged, NAMES, film_window(scene))
    differs = np.any([bits_differ(ours, moved, name) for name in NAMES], axis=0)
    rows = np.flatnonzero(differs & (rays.t_min > 0.0))
    if len(rows):
        rows = np.random.default_rng(1).choice(rows, min(SAMPLE, len(rows)), replace=False)
        differs &= rays.t_min == 0.0
        differs[rows] = ~_right(scene, ours, rows, _some(rays, rows))
    return worst_of("render", {"pixel": np.where(differs, np.inf, 0.0)}, np.ones(len(o), bool), scene)


def _some(rays: Any, rows: np.ndarray) -> Line:
    """Some of the camera's rays."""
    return Line(rays.o[rows], rays.d[rows], rays.t_min[rows], rays.t_max[rows])


def _right(scene: Scene, ours: Aovs, rows: np.ndarray, rays: Line) -> np.ndarray:
    """(m,) bool: geometry within float64's bracket, diffuse as the lights' definitions give it there."""
    depth, n, sh_n, p, shape, diffuse, prim = (flat(ours, name)[rows] for name in NAMES)
    t = depth / norm(rays.d)
    model = model_of(scene, pack(scene, as_given), SharedRays(rays.o, rays.d, rays.t_max, np.zeros(len(t))))
    bracket = Bracket(model, KU_OURS, ours=True)
    claims = Claims(t, shape, n, sh_n, p, KU_OURS * t)
    found = bracket.judge(rays.o, rays.d, rays.t_max, claims, t_min=rays.t_min)
    right = found.allowed | found.open
    hit = np.flatnonzero(right & (shape >= 0))
    o, d, t, shape = rays.o[hit], rays.d[hit], t[hit], shape[hit]
    prim = model.packed.first[shape] + prim[hit]
    at = nearest_root(model.meet(prim, o, d, KU_OURS, ours=True), t)
    right[hit] &= right_in_float64(scene, Hit(o + t[:, None] * d, d, shape, at), prim, diffuse[hit], bracket)
    return right

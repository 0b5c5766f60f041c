"""Mitsuba's errors at its hits, in units of the rounding that the error models count."""

from typing import NamedTuple

import numpy as np
from aimed_rays import Setting, rays_at, scene_of

from mitsuba_ref.error_model.bounds import error_over_bound, nearest_root
from mitsuba_ref.error_model.bracket import Bracket, Claims
from mitsuba_ref.error_model.intersections import Rays, norm
from mitsuba_ref.error_model.scene_model import SceneModel
from mitsuba_ref.error_model.tolerances import KU, KU_OURS, K
from mitsuba_ref.reference import mitsuba_process
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.mitsuba_process import SendRequest
from mitsuba_ref.reference.rendering import ReferenceResult, trace_reference
from mitsuba_ref.reference.shared_input import endless_rays, model_of, packed_float32


class Observed(NamedTuple):
    """One row for each ray, unless stated otherwise."""

    hit: np.ndarray  # Mitsuba's
    resolved: np.ndarray  # a hit whose primitive float32 resolves
    k: dict[str, np.ndarray]  # of t, n, sh_n and p: K times error over bound at resolved hits, (m,) each
    possible: np.ndarray  # whether the primitive that Mitsuba names may be hit, (m,)
    allowed: np.ndarray  # whether the bracket allows what Mitsuba says
    open_ended: np.ndarray  # whether it leaves any claim open
    certain: np.ndarray  # whether something is certainly hit
    true_hit: np.ndarray  # the same by float64


def observe(
    kind: str,
    setting: Setting,
    seed: list[int],
    *,
    shapes: int,
    count: int,
    send: SendRequest = mitsuba_process.send_request,
) -> Observed:
    """Ask Mitsuba about `count` rays aimed at `shapes` shapes, and compare with the models alone."""
    rng = np.random.default_rng(seed)
    scene = scene_of(kind, rng, setting, shapes)
    o, d = rays_at(scene, rng, setting, count)
    rays = endless_rays(o, d)
    model = model_of(scene, packed_float32(scene), rays)
    witness = trace_reference(scene, model, rays, lights=False, send=send)
    assert not isinstance(witness, Crash), witness
    return compared(model, witness, o, d)


def compared(model: SceneModel, witness: ReferenceResult, o: np.ndarray, d: np.ndarray) -> Observed:
    answer, t_max = witness.answer, np.full(len(o), np.inf)
    n, sh_n, p = (a.astype(np.float64) for a in (answer.n, answer.sh_n, answer.p))
    bracket = Bracket(model, KU, ours=False)
    finding = bracket.judge(o, d, t_max, Claims(witness.t, witness.shape_id, n, sh_n, p))
    rows = np.flatnonzero(witness.hit)
    prim = named(model, witness)[rows]
    at = nearest_root(model.intersect(prim, o[rows], d[rows], KU, ours=False), witness.t[rows])
    resolved = np.isfinite(at.t_error)
    k = {
        "t": K * error_over_bound(np.abs(witness.t[rows] - at.t), at.t_error)[resolved],
        "n": K * error_over_bound(norm(n[rows] - at.n), at.n_error)[resolved],
        "sh_n": K * error_over_bound(norm(sh_n[rows] - at.sh_n), at.sh_error)[resolved],
        "p": K * error_over_bound(norm(p[rows] - (o[rows] + at.t[:, None] * d[rows])), at.p_error)[resolved],
    }
    everywhere = np.zeros(len(o), bool)
    everywhere[rows] = resolved
    rays = Rays(o, d, np.zeros(len(o)), t_max)
    certain, true_hit = (each.blocked(rays)[1] for each in (bracket, Bracket(model, KU_OURS, ours=True)))
    judged = (at.possible[resolved], finding.allowed, finding.open)
    return Observed(witness.hit, everywhere, k, *judged, certain, true_hit)


def named(model: SceneModel, witness: ReferenceResult) -> np.ndarray:
    """The primitive that Mitsuba says it hit, numbered through the scene; a plane has only one, whatever its patch."""
    packed = model.packed
    first = packed.first[np.maximum(witness.shape_id, 0)]
    count = np.diff(packed.first)[np.maximum(witness.shape_id, 0)]
    return np.where(witness.shape_id < 0, -1, first + np.minimum(witness.answer.prim, count - 1))

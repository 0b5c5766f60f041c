"""Lookup of known defects of the reference, which kinds of primitives declare (mitsuba_ref/shapes).

Also computes the features of a pixel that they depend on.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from mitsuba_ref.error_model.bounds import intersections_at
from mitsuba_ref.error_model.bracket import Bracket, Claims
from mitsuba_ref.error_model.defect_conditions import (
    NAN_T,
    WIDENED_BOUNDS_FACTOR,
    DefectFeatures,
    DefectView,
    KnownDefect,
)
from mitsuba_ref.error_model.intersections import Array, Rays, norm, without_float_warnings, without_overflow_warnings
from mitsuba_ref.error_model.scene_model import REFERENCE_SIDE, SceneModel, Side
from mitsuba_ref.error_model.tolerances import KU
from mitsuba_ref.judge.adjudication import prims_and_t
from mitsuba_ref.oracle.oracle import ExactAnswer, Oracle
from mitsuba_ref.shapes import KINDS, kind_of


def known_defects() -> tuple[KnownDefect, ...]:
    """All declared defects in the order of their priority."""
    declared = {defect for kind in KINDS.values() for defect in kind.known_defects} | {NAN_T}
    return tuple(sorted(declared, key=lambda defect: (defect.priority, defect.number)))


def defect_name(number: int) -> str:
    """The defect of this number in words."""
    return next(defect.name for defect in known_defects() if defect.number == number)


def defect_of(features: DefectFeatures) -> int | None:
    """The number of the known defect that fits (of several, the one of lowest `priority`), or None."""
    ours, theirs = {features.ours}, {features.theirs}
    subjects = {"missed": ours - theirs, "named": theirs, "either": ours | theirs}
    found = [
        defect
        for kind in KINDS.values()
        for defect in kind.known_defects
        if kind.name in subjects[defect.subject] and defect.condition(features)
    ]
    if NAN_T.condition(features):
        found.append(NAN_T)
    return min(found, key=lambda defect: defect.priority).number if found else None


LEAST_FLOAT64 = 2.0**-1074


def defect_features(
    model: SceneModel,
    oracle: Oracle,
    lines: Rays,
    claims: Claims,
    answers: Sequence[ExactAnswer],
    named: Array,
    robust: bool = True,
) -> Iterator[DefectFeatures]:
    """Features at m pixels of one scene.

    claims: the reference's; named: (m,) its primitives, -1 on a miss; robust: its mode.
    """
    o, d = lines[:2]
    wide = Bracket(model, Side(WIDENED_BOUNDS_FACTOR * KU, own=False), closed=robust)
    nearly = wide.judge(lines, claims, also=named).allowed
    whole, normless = _with_normals(model, o, d, claims, named)
    normless &= wide.judge(lines, whole, also=named).allowed
    hit, _ = prims_and_t(answers)
    distance, offset = np.maximum(_distance_and_offset(model, hit, o), _distance_and_offset(model, named, o))
    for i, answer in enumerate(answers):
        t, prim = float(claims.t[i]), int(named[i])
        (kind, ours), (their_kind, theirs) = (_view(model, int(each), o[i], d[i], t) for each in (hit[i], prim))
        yield DefectFeatures(
            kind,
            their_kind,
            where=frozenset(hit.where for hit in answer.ties),
            t=t,
            at_zero=t == 0.0 and _is_at_zero(model, oracle, int(claims.shape[i]), prim, o[i], d[i]),
            cosine=min(ours.cosine, theirs.cosine),
            beyond_corners=theirs.beyond_corners,
            without_area=theirs.without_area,
            slenderness=min(ours.slenderness, theirs.slenderness),
            distance=float(distance[i]),
            offset=float(offset[i]),
            axis_angle=min(ours.axis_angle, theirs.axis_angle),
            stretch=max(ours.stretch, theirs.stretch),
            nearly=bool(nearly[i]),
            normless=bool(normless[i]),
            robust=robust,
            starts_inside=ours.starts_inside or theirs.starts_inside,
        )


def _with_normals(model: SceneModel, o: Array, d: Array, claims: Claims, prims: Array) -> tuple[Claims, Array]:
    """(the claims, with missing normals filled in; (m,) bool: rounding may be why a normal is missing).

    A normal with a bound of 1 or more, its own length, may vanish, and is then 0/0.
    """
    rows = np.flatnonzero((prims >= 0) & np.isnan(claims.n).any(axis=1) & np.isfinite(claims.t))
    normless = np.zeros(len(prims), bool)
    n, sh_n, p = claims.n.copy(), claims.sh_n.copy(), claims.p.copy()
    at = intersections_at(model, prims[rows], o[rows], d[rows], claims.t[rows], REFERENCE_SIDE)
    n[rows], sh_n[rows], normless[rows] = at.n, at.sh_n, at.n_error >= 1.0
    p[rows] = o[rows] + at.t[:, None] * d[rows]
    return claims._replace(n=n, sh_n=sh_n, p=p), normless


@without_float_warnings
def _distance_and_offset(model: SceneModel, prims: Array, o: Array) -> tuple[Array, Array]:
    """(m,) distances of primitives from o and of their farthest corners from the origin, over their sizes; or 0."""
    low, high = (corner[prims] for corner in model.boxes)
    size = (high - low).max(axis=1)
    away = norm(np.maximum(np.maximum(low - o, o - high), 0.0))
    farthest = np.maximum(np.abs(low), np.abs(high)).max(axis=1)
    sized = (prims >= 0) & np.isfinite(size) & (size > 0.0)
    return np.where(sized, away / size, 0.0), np.where(sized, farthest / size, 0.0)


@without_overflow_warnings
def _view(model: SceneModel, prim: int, o: Array, d: Array, t: float) -> tuple[str, DefectView]:
    """The kind of one primitive, "" for none, and its measures of the ray."""
    if prim < 0:
        return "", DefectView()
    kind, k = model.packed.place_of(prim)
    reference = kind_of(kind.prims)
    return reference.name, reference.defect_view(kind.prims, k, o, d, t)


def _is_at_zero(model: SceneModel, oracle: Oracle, shape: int, prim: int, o: Array, d: Array) -> bool:
    """Whether the primitive is hit at t = 0 up to its bound, or another one of that shape exactly there."""
    if shape < 0:
        return False
    if prim >= 0:
        at = model.intersect(np.array([prim]), o[None], d[None], REFERENCE_SIDE).at
        if (np.isfinite(at.t_error) & (np.abs(at.t) <= at.t_error)).any():
            return True
    first, end = model.packed.first[shape : shape + 2]
    answer = oracle.first_hit(o, d, -LEAST_FLOAT64, 0.0)
    return answer.t == 0 and bool(((answer.prims >= first) & (answer.prims < end)).any())

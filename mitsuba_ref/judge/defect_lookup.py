"""Lookup of known defects of the reference, which kinds of primitives declare (mitsuba_ref/shapes).

Also computes the features of a pixel that they depend on.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from mitsuba_ref.error_model.bounds import nearest_root
from mitsuba_ref.error_model.bracket import Bracket, Claims
from mitsuba_ref.error_model.defect_conditions import (
    NAN_T,
    WIDENED_BOUNDS_FACTOR,
    DefectFeatures,
    DefectView,
    KnownDefect,
)
from mitsuba_ref.error_model.scene_model import SceneModel, kinds_of
from mitsuba_ref.error_model.tolerances import KU
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
    involved = [kind for kind in KINDS.values() if kind.name in features.kinds]
    found = [defect for kind in involved for defect in kind.known_defects if defect.applies(kind.name, features)]
    if NAN_T.condition(features):
        found.append(NAN_T)
    return min(found, key=lambda defect: defect.priority).number if found else None


MAX_PRIMS_TESTED_AT_ZERO = 64  # primitives of the named shape, nearest first, that are tested for a hit at t = 0


class FeatureMeasurement:
    """Measures features at pixels of one scene."""

    def __init__(self, model: SceneModel, oracle: Oracle):
        self.model, self.oracle = model, oracle
        self.wide = Bracket(model, WIDENED_BOUNDS_FACTOR * KU, ours=False)

    def all_of(
        self,
        lines: tuple[np.ndarray, np.ndarray, np.ndarray],
        claims: Claims,
        answers: Sequence[ExactAnswer],
        prims: Sequence[int],
    ) -> Iterator[DefectFeatures]:
        """Features at m pixels.

        lines: o (m, 3), d (m, 3), t_max (m,); claims: the reference's; prims: the primitives it names, -1 on a miss.
        """
        o, d, _ = lines
        named = np.asarray(prims, np.int64)
        nearly = self.wide.judge(*lines, claims, also=named).allowed
        whole, normless = self._with_normals(o, d, claims, named)
        normless &= self.wide.judge(*lines, whole, also=named).allowed
        for i, (answer, prim) in enumerate(zip(answers, prims, strict=True)):
            t, shape = float(claims.t[i]), int(claims.shape[i])
            at_zero = t == 0.0 and self._at_zero(shape, prim, o[i], d[i])
            yield self._measured(o[i], d[i], t, answer, prim, (at_zero, bool(nearly[i]), bool(normless[i])))

    def _with_normals(
        self, o: np.ndarray, d: np.ndarray, claims: Claims, prims: np.ndarray
    ) -> tuple[Claims, np.ndarray]:
        """(the claims, with missing normals filled in; (m,) bool: rounding may be why a normal is missing).

        A normal with a bound of 1 or more, its own length, may vanish, and is then 0/0.
        """
        rows = np.flatnonzero((prims >= 0) & np.isnan(claims.n).any(axis=1) & np.isfinite(claims.t))
        normless = np.zeros(len(prims), bool)
        n, sh_n, p = claims.n.copy(), claims.sh_n.copy(), claims.p.copy()
        if len(rows):
            met = self.model.intersect(prims[rows], o[rows], d[rows], KU, ours=False)
            at = nearest_root(met, claims.t[rows])
            n[rows], sh_n[rows] = at.n, at.sh_n
            p[rows] = o[rows] + at.t[:, None] * d[rows]
            normless[rows] = at.n_error >= 1.0
        return claims._replace(n=n, sh_n=sh_n, p=p), normless

    def _measured(
        self, o: np.ndarray, d: np.ndarray, t: float, answer: ExactAnswer, named: int, flags: tuple[bool, bool, bool]
    ) -> DefectFeatures:
        """flags: at_zero, nearly, normless."""
        hit, (at_zero, nearly, normless) = answer.prim, flags
        views = {each: self._view(each, o, d, t) for each in (hit, named) if each >= 0}
        sizes = [self._distance_and_offset(each, o) for each in views]
        theirs = views.get(named, DefectView())
        return DefectFeatures(
            self._kind(hit),
            self._kind(named),
            where=frozenset(where for where, _ in answer.groups),
            flags=answer.flags,
            t=t,
            at_zero=at_zero,
            cosine=min((view.cosine for view in views.values()), default=1.0),
            beyond_corners=theirs.beyond_corners,
            without_area=theirs.without_area,
            slenderness=min((view.slenderness for view in views.values()), default=1.0),
            distance=max((distance for distance, _ in sizes), default=0.0),
            offset=max((offset for _, offset in sizes), default=0.0),
            axis_angle=min((view.axis_angle for view in views.values()), default=1.0),
            stretch=max((view.stretch for view in views.values()), default=1.0),
            nearly=nearly,
            normless=normless,
        )

    def _place(self, prim: int) -> tuple[Any, int]:
        """(arrays of its kind, its row there)."""
        kind, k = kinds_of(self.model.packed, np.array([prim]))
        return self.model.packed.kinds[int(kind[0])].prims, int(k[0])

    def _kind(self, prim: int) -> str:
        return kind_of(self._place(prim)[0]).name if prim >= 0 else ""

    def _at_zero(self, shape: int, prim: int, o: np.ndarray, d: np.ndarray) -> bool:
        """Whether the primitive is hit at t = 0 up to its bound, or another one of that shape exactly there."""
        if shape < 0:
            return False
        if prim >= 0:
            at = self.model.intersect(np.array([prim]), o[None], d[None], KU, ours=False).at
            near = bool((np.isfinite(at.t_error) & (np.abs(at.t) <= at.t_error)).any())
            if near or kind_of(self._place(prim)[0]).model.unfold is not None:
                return near
        first, last = (int(n) for n in self.model.packed.first[shape : shape + 2])
        low, high = (corner[first:last] for corner in self.model.boxes)
        away = np.maximum(np.maximum(low - o, o - high), 0.0).max(axis=1)
        nearest = first + np.argsort(away, kind="stable")[:MAX_PRIMS_TESTED_AT_ZERO]
        tested = dict.fromkeys([prim, *nearest.tolist()])
        return any(hit.t == 0 for each in tested for hit in self.oracle.roots(each, o, d))

    def _view(self, prim: int, o: np.ndarray, d: np.ndarray, t: float) -> DefectView:
        """Measures of one primitive and the ray, by its kind."""
        prims, k = self._place(prim)
        with np.errstate(divide="ignore", invalid="ignore"):
            return kind_of(prims).defect_view(prims, k, o, d, t)

    def _distance_and_offset(self, prim: int, o: np.ndarray) -> tuple[float, float]:
        """Distances of a primitive from o and of its farthest corner from the origin, over its size; 0 without one."""
        low, high = (corner[prim] for corner in self.model.boxes)
        size = float(np.max(high - low))
        if not (np.isfinite(size) and size > 0.0):
            return 0.0, 0.0
        away = float(np.linalg.norm(np.maximum(np.maximum(low - o, o - high), 0.0)))
        return away / size, float(np.max(np.maximum(np.abs(low), np.abs(high)))) / size

"""Features of a pixel where the reference is wrong, from which its known defect follows (known_defects.py)."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from mitsuba_ref.error_model.bounds import nearest_root
from mitsuba_ref.error_model.bracket import Bracket, Claims
from mitsuba_ref.error_model.intersections import KU
from mitsuba_ref.error_model.scene_model import SceneModel
from mitsuba_ref.judge.known_defects import (
    CYLINDERS,
    ELLIPSOIDS,
    PLANES,
    SPHERES,
    TRIANGLES,
    WIDENED_BOUNDS_FACTOR,
    DefectFeatures,
)
from mitsuba_ref.oracle.oracle import ExactAnswer, Oracle

MAX_PRIMS_TESTED_AT_ZERO = (
    64  # primitives of the shape that the reference names which are asked for a hit at t = 0, nearest first
)


class FeatureMeasurement:
    """Measures pixels of one scene."""

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
        """m pixels. lines: o (m, 3), d (m, 3), t_max (m,); claims: the reference's; prims: the numbers of what it says
        is hit, -1 on a miss."""
        o, d, _ = lines
        named = np.asarray(prims, np.int64)
        nearly = self.wide.judge(*lines, claims, also=named).allowed
        whole, normless = self._with_normals(o, d, claims, named)
        normless &= self.wide.judge(*lines, whole, also=named).allowed
        for i, (answer, prim) in enumerate(zip(answers, prims, strict=True)):
            t, shape = float(claims.t[i]), int(claims.shape[i])
            at_zero = t == 0.0 and self._at_zero(shape, prim, o[i], d[i])
            found = self._measured(o[i], d[i], t, answer, prim, at_zero)
            yield replace(found, nearly=bool(nearly[i]), normless=bool(normless[i]))

    def _with_normals(
        self, o: np.ndarray, d: np.ndarray, claims: Claims, prims: np.ndarray
    ) -> tuple[Claims, np.ndarray]:
        """(the claims, made whole where they have no normal; where that is, and rounding may be the reason).

        A normal that is bounded no closer than its own length, 1, may have any length, 0 included, and then it is 0/0.
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
        self,
        o: np.ndarray,
        d: np.ndarray,
        t: float,
        answer: ExactAnswer,
        prim: int,
        at_zero: bool,
    ) -> DefectFeatures:
        ours, theirs = (self._kind(each) for each in (answer.prim, prim))
        looks = [self._look(each, o, d) for each in (answer.prim, prim) if each >= 0]
        triangle = self._corners(prim) if theirs == TRIANGLES else None
        return DefectFeatures(
            ours,
            theirs,
            where=frozenset(each.where for each in answer.ties),
            flags=answer.flags,
            t=t,
            at_zero=at_zero,
            cosine=min((look["cosine"] for look in looks), default=1.0),
            beyond_corners=triangle is not None and _beyond(triangle, o, d, t),
            without_area=triangle is not None and not has_area(triangle),
            slenderness=min((look["slenderness"] for look in looks), default=1.0),
            distance=max((look["distance"] for look in looks), default=0.0),
            offset=max((look["offset"] for look in looks), default=0.0),
            axis_angle=min((look["axis_angle"] for look in looks), default=1.0),
            stretch=max((look["stretch"] for look in looks), default=1.0),
            nearly=False,
        )

    def _place(self, prim: int) -> tuple[Any, int]:
        """(arrays of its kind, its row there)."""
        packed = self.model.packed
        shape = int(packed.shape_of(np.array([prim]))[0])
        kind = packed.kinds[int(packed.kind_of[shape])]
        return kind.prims, int(prim - packed.first[shape] + packed.start[shape])

    def _kind(self, prim: int) -> str:
        return type(self._place(prim)[0]).__name__ if prim >= 0 else ""

    def _corners(self, prim: int) -> np.ndarray:
        prims, k = self._place(prim)
        corners: np.ndarray = prims.vertices[prims.faces[k]]
        return corners

    def _at_zero(self, shape: int, prim: int, o: np.ndarray, d: np.ndarray) -> bool:
        """Whether the primitive, or another one of that shape, is met at t = 0; a plane, as its patch may be."""
        if shape < 0:
            return False
        if self._kind(prim) == PLANES:
            at = self.model.intersect(np.array([prim]), o[None], d[None], KU, ours=False).at
            return bool((np.isfinite(at.t_error) & (np.abs(at.t) <= at.t_error)).any())
        first, last = (int(n) for n in self.model.packed.first[shape : shape + 2])
        low, high = (corner[first:last] for corner in self.model.boxes)
        away = np.maximum(np.maximum(low - o, o - high), 0.0).max(axis=1)
        nearest = first + np.argsort(away, kind="stable")[:MAX_PRIMS_TESTED_AT_ZERO]
        asked = dict.fromkeys([prim, *nearest.tolist()])
        return any(hit.t == 0 for each in asked for hit in self.oracle.roots(each, o, d))

    def _look(self, prim: int, o: np.ndarray, d: np.ndarray) -> dict[str, float]:
        """The shape of one primitive as the ray sees it."""
        prims, k = self._place(prim)
        kind = type(prims).__name__
        found = {"cosine": 1.0, "slenderness": 1.0, "axis_angle": 1.0, "stretch": 1.0}
        low, high = (corner[prim] for corner in self.model.boxes)
        size = float(np.max(high - low))
        with np.errstate(divide="ignore", invalid="ignore"):
            away = float(np.linalg.norm(np.maximum(np.maximum(low - o, o - high), 0.0)))
            ends = float(np.max(np.maximum(np.abs(low), np.abs(high))))
            found["distance"] = away / size if np.isfinite(size) and size > 0.0 else 0.0
            found["offset"] = ends / size if np.isfinite(size) and size > 0.0 else 0.0
        if kind == TRIANGLES:
            found |= _triangle(prims.vertices[prims.faces[k]], d)
        elif hasattr(prims, "normal"):
            found["cosine"] = abs_cosine(prims.normal[k], d)
        elif hasattr(prims, "to_world") and kind not in (SPHERES, ELLIPSOIDS, CYLINDERS):
            found["cosine"] = abs_cosine(prims.to_object[k][2], d)
        elif kind in (ELLIPSOIDS, CYLINDERS):
            found["stretch"] = float(np.linalg.norm(prims.to_object[k] @ d))
            if kind == CYLINDERS:
                axis = prims.to_world[k][:, 2]
                found["axis_angle"] = float(
                    np.linalg.norm(np.cross(axis, d)) / (np.linalg.norm(axis) * np.linalg.norm(d))
                )
        return found


def abs_cosine(n: np.ndarray, d: np.ndarray) -> float:
    """|cos| of the angle between two vectors; 1 where one has no length."""
    lengths = float(np.linalg.norm(n) * np.linalg.norm(d))
    return abs(float(n @ d)) / lengths if lengths > 0.0 else 1.0


def _triangle(corners: np.ndarray, d: np.ndarray) -> dict[str, float]:
    edges = np.roll(corners, -1, axis=0) - corners
    longest = float(np.linalg.norm(edges, axis=1).max())
    across = np.cross(edges[0], edges[1])
    area = float(np.linalg.norm(across))
    slenderness = area / longest**2 if longest > 0.0 else 0.0
    return {"cosine": abs_cosine(across, d), "slenderness": slenderness}


def _beyond(corners: np.ndarray, o: np.ndarray, d: np.ndarray, t: float) -> bool:
    """Whether t lies outside of what the corners span along the ray, by more than the rounding of it."""
    along = (corners - o) @ d / float(d @ d)
    room = KU * (np.abs(along).max() + abs(t))
    return bool(t > along.max() + room or t < along.min() - room)


def has_area(corners: np.ndarray) -> bool:
    """Whether the triangle has an area, exactly: its edges' cross product in whole numbers."""
    a, b, c = ([Fraction(x) for x in corner] for corner in corners.tolist())
    u, v = ([x - y for x, y in zip(p, a, strict=True)] for p in (b, c))
    return any(u[i] * v[j] != u[j] * v[i] for i, j in ((0, 1), (1, 2), (2, 0)))

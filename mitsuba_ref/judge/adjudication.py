"""Who is right where brackets are not enough: our answer against exact arithmetic, pixel by pixel."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mitsuba_ref.error_model.bounds import Bounds, nearest_root
from mitsuba_ref.error_model.bracket import Claims
from mitsuba_ref.error_model.intersections import KU, norm
from mitsuba_ref.error_model.scene_model import SceneModel
from mitsuba_ref.oracle.oracle import ExactAnswer, Oracle, OutsideDomain

# Agreeing pixels of a scene, away from edges, that are held to exact arithmetic all the same: a tenth of a second.
AGREEING_PIXELS_ADJUDICATED = 1024
ADJUDICATION_SEED = 2


@dataclass(frozen=True)
class Adjudication:
    """What the oracle says of some pixels, and how ours compares; one row a pixel that was asked about."""

    rows: np.ndarray  # (m,) their places in the picture, ascending
    answers: Sequence[ExactAnswer | None]  # m of them; None: the oracle gave none
    share: (
        np.ndarray
    )  # (m,) |our t - the exact one| over its bound; inf where hit, miss or primitive is another

    @property
    def answered(self) -> np.ndarray:
        """(m,) bool."""
        return np.array([answer is not None for answer in self.answers], bool)

    @property
    def right(self) -> np.ndarray:
        """(m,) bool: ours is the exact answer."""
        return self.answered & (self.share <= 1.0)

    @property
    def wrong(self) -> np.ndarray:
        """(m,) bool: it is not."""
        return self.answered & ~(self.share <= 1.0)

    @cached_property
    def place(self) -> dict[int, int]:
        """Row of the picture -> row here."""
        return {int(row): i for i, row in enumerate(self.rows)}

    def of(self, row: int) -> ExactAnswer | None:
        """What the oracle says of a row of the picture, if it was asked."""
        i = self.place.get(int(row))
        return None if i is None else self.answers[i]

    def are_right(self, rows: np.ndarray) -> np.ndarray:
        """(len(rows),) bool: ours is exactly right at these rows of the picture; False where nobody asked."""
        return np.isin(rows, self.rows[self.right])


def needs_adjudication(
    plain: np.ndarray, hit: np.ndarray, certain: np.ndarray, shape: tuple[int, int]
) -> np.ndarray:
    """Rows to ask about: what does not plainly agree, what is near an edge, and some of the rest by a fixed seed.

    plain, hit, certain: (n,) bool; hit by ours, certain to be hit for the reference; shape: of the picture.
    """
    asked = ~plain | (hit & ~certain) | (~hit & has_hit_neighbor(hit.reshape(shape)).ravel())
    rest = np.flatnonzero(~asked)
    asked[
        np.random.default_rng(ADJUDICATION_SEED).choice(
            rest, min(AGREEING_PIXELS_ADJUDICATED, len(rest)), replace=False
        )
    ] = True
    return np.flatnonzero(asked)


def has_hit_neighbor(hit: np.ndarray) -> np.ndarray:
    """(h, w) bool: pixels with a neighbour, corners included, that is hit."""
    padded = np.pad(hit, 1)
    height, width = hit.shape
    shifts = [padded[y : y + height, x : x + width] for y in range(3) for x in range(3)]
    near: np.ndarray = np.any(shifts, axis=0)
    return near


def adjudicate(
    oracle: Oracle,
    rays: tuple[np.ndarray, np.ndarray, np.ndarray],
    ours: tuple[np.ndarray, np.ndarray],
    bounds: Bounds,
    rows: np.ndarray,
) -> Adjudication:
    """Ask about the pixels `rows`. rays: o (n, 3), d (n, 3), t_max (n,); ours: t (n,), prim (n,).

    Where t_max is negative there is no ray, and so no answer.
    """
    o, d, t_max = rays
    t, prim = ours
    rows = rows[t_max[rows] >= 0.0]
    answers = oracle_answers(oracle, o[rows], d[rows], t_max[rows])
    error = bounds.own.t_error[rows]
    share = [
        np.inf if answer is None else exact_error_ratio(answer, int(prim[i]), float(t[i]), float(bound))
        for answer, i, bound in zip(answers, rows, error, strict=True)
    ]
    return Adjudication(rows, answers, np.array(share, np.float64))


def oracle_answers(
    oracle: Oracle, o: np.ndarray, d: np.ndarray, t_max: np.ndarray
) -> Sequence[ExactAnswer | None]:
    """One answer a ray; if some ray has none, the others still have theirs."""
    try:
        return oracle.first_hits(o, d, 0.0, t_max)
    except OutsideDomain:
        if len(o) == 1:
            return [None]
        half = len(o) // 2
        return [
            *oracle_answers(oracle, o[:half], d[:half], t_max[:half]),
            *oracle_answers(oracle, o[half:], d[half:], t_max[half:]),
        ]


def exact_error_ratio(answer: ExactAnswer, prim: int, t: float, bound: float) -> float:
    """How far ours is from the exact answer, over the bound of float64 on t (KU_OURS times the ray's condition).

    0 where float64 does not resolve the crossing, edge-on up to its rounding: which primitive is hit is all there is
    to check. inf where that differs, or hit and miss.
    """
    if answer.t is None or prim != answer.prim:
        return 0.0 if answer.prim == prim else np.inf
    if np.isposinf(bound) and np.isfinite(t):
        return 0.0
    off = answer.t.off(t) if np.isfinite(t) else np.inf
    return 0.0 if off == 0.0 else off / bound if bound > 0.0 else np.inf


def claims_other_tie(
    model: SceneModel,
    o: np.ndarray,
    d: np.ndarray,
    claims: Claims,
    answers: Sequence[ExactAnswer | None],
    closest: float,
) -> np.ndarray:
    """(m,) bool: the claim is that of another member of the exact tie set than the first, within its bounds there.

    closest: no bound on a normal may be looser, or agreement would say nothing.
    """
    others = [(i, each) for i, a in enumerate(answers) if a is not None for each in a.ties[1:]]
    taken = np.zeros(len(o), bool)
    if not others:
        return taken
    ray = np.array([i for i, _ in others])
    prim = np.array([each.prim for _, each in others])
    t = np.array([float(each.t) for _, each in others])
    at = nearest_root(model.intersect(prim, o[ray], d[ray], KU, ours=False), t)
    p = o[ray] + t[:, None] * d[ray]
    with np.errstate(invalid="ignore"):
        fits = (
            (model.packed.shape_of(prim) == claims.shape[ray])
            & (np.abs(claims.t[ray] - t) <= at.t_error)
            & np.isfinite(at.t_error)
            & (claims.t[ray] > 0.0)
            & (norm(claims.n[ray] - at.n) <= np.minimum(at.n_error, closest))
            & (norm(claims.sh_n[ray] - at.sh_n) <= np.minimum(at.sh_error, closest))
            & (norm(claims.p[ray] - p) <= at.p_error)
        )
    taken[ray[fits]] = True
    return taken

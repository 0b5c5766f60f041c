"""Adjudication: compare the subject with exact arithmetic at pixels where bounds alone do not decide.

Also gives exact answers for arbitrary float32 rays of a scene, with error bounds on t.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from caster.geometry.packing import Packed
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import intersections_at, row_distance
from mitsuba_ref.error_model.bracket import ANY_SHAPE, CLAIMED_MISS, NOT_CLAIMED, Claims
from mitsuba_ref.error_model.intersections import Array, Intersections, Rays, without_float_warnings
from mitsuba_ref.error_model.scene_model import SceneModel, Side
from mitsuba_ref.error_model.tolerances import LARGEST_USEFUL_NORMAL_ERROR
from mitsuba_ref.oracle.oracle import ExactAnswer, Oracle, OutsideDomain
from mitsuba_ref.reference.shared_input import endless_rays, model_of
from mitsuba_ref.subjects.subject import Answer

ADJUDICATION_SEED = 2


@dataclass(frozen=True)
class Adjudication:
    """Exact answers at some pixels, and the subject's errors; one row for each adjudicated pixel."""

    rows: Array  # (m,) of the image, ascending
    answers: Sequence[ExactAnswer | None]  # m of them; None: the oracle gave none
    ratio: Array  # (m,) the subject's error over its bound; inf where hit, miss or primitive is another
    of_first: Array  # (m,) bool: it has the first member of the tie set, or nothing is hit

    @property
    def answered(self) -> Array:
        """(m,) bool."""
        return np.array([answer is not None for answer in self.answers], bool)

    @property
    def right(self) -> Array:
        """(m,) bool: the subject has the exact answer."""
        return self.answered & (self.ratio <= 1.0)

    @property
    def wrong(self) -> Array:
        """(m,) bool: the subject has another answer."""
        return self.answered & ~(self.ratio <= 1.0)

    @cached_property
    def by_row(self) -> dict[int, ExactAnswer | None]:
        """The answer to each adjudicated row of the image."""
        return dict(zip(self.rows.tolist(), self.answers, strict=True))

    def of(self, row: int) -> ExactAnswer | None:
        """The exact answer at a row of the image, if it was adjudicated."""
        return self.by_row.get(int(row))

    def first_hits(self, rows: Array) -> tuple[Array, Array]:
        """As `prims_and_t`, at some rows; -1 and inf also where the answer is not known."""
        return prims_and_t([self.of(row) or MISS for row in rows])


MISS = ExactAnswer(None, ())


def prims_and_t(answers: Sequence[ExactAnswer]) -> tuple[Array, Array]:
    """(m,) primitive and t of exact answers; -1 and inf on a miss."""
    prim = np.array([answer.prim for answer in answers], np.int64)
    return prim, np.array([answer.distance for answer in answers])


def sample_rows(rows: Array, count: int) -> Array:
    """At most `count` of these rows, chosen by a fixed seed, ascending."""
    chosen = np.random.default_rng(ADJUDICATION_SEED).choice(rows, min(count, len(rows)), replace=False)
    return np.sort(chosen)


def oracle_answers(oracle: Oracle, lines: Rays) -> Sequence[ExactAnswer | None]:
    """The exact answer to each ray; None for a ray that the oracle cannot answer."""
    try:
        return oracle.first_hits(*lines)
    except OutsideDomain:
        if len(lines.o) == 1:
            return [None]
        half = len(lines.o) // 2
        parts = lines.take(slice(half)), lines.take(slice(half, None))
        return [answer for part in parts for answer in oracle_answers(oracle, part)]


def claims_of(answer: Answer, packed: Packed) -> Claims:
    """The claims of a subject: hits, with shape, primitive and normal if it gives them; no positions."""
    named: Array | int = ANY_SHAPE
    if answer.shape_id is not None:  # a negative number names no shape, as one beyond the last does
        named = np.where(answer.shape_id >= 0, answer.shape_id, len(packed.parts))
    shape, prim = np.where(answer.hit, named, CLAIMED_MISS), answer.prim_id
    t = np.where(answer.hit, np.nan, np.inf) if answer.hits_only else answer.t
    n = NOT_CLAIMED if answer.n is None else answer.n
    return Claims(t, shape, n, t_rounding=answer.t_rounding, prim=prim)


def id_columns(answer: Answer, packed: Packed) -> list[tuple[str, Array, Callable[[Array], Array]]]:
    """(name, (n,) the subject's numbers, primitives of the scene -> the right numbers) of each column that is given."""
    columns = (
        ("shape", answer.shape_id, packed.shape_of),
        ("primitive", answer.prim_id, packed.index_in_shape),
        ("primitive", answer.prim, lambda prim: prim),
    )
    return [(name, ids, number) for name, ids, number in columns if ids is not None]


def named_prims(scene: Scene, packed: Packed, prims: Array) -> list[tuple[str, int]]:
    """(name of the shape, number within it) of each primitive."""
    names = scene.shape_names()
    pairs = zip(packed.shape_of(prims), packed.index_in_shape(prims), strict=True)
    return [(names[shape], int(number)) for shape, number in pairs]


def exact_ratios(
    answers: Sequence[ExactAnswer | None],
    answer: Answer,
    near: Callable[[Array, Array, Array], Intersections],
    packed: Packed,
) -> tuple[Array, Array]:
    """(m,) a subject's error over its bound, and whether it has the first member of the tie set; answer: to m pixels.

    near: (k,) numbers of pixels, primitives and t -> the intersections as the subject may see them.

    Of a subject with exact visibility, the first member alone is right; of others every member, and the best one
    counts. t is compared, and the normal and ids if they are given; where rounding cannot resolve t, these alone.
    """
    hit = answer.hit
    missed = np.array([exact is not None and exact.t is None for exact in answers], bool)
    best = np.where(missed & ~hit, 0.0, np.inf)
    first = best == 0.0
    members = [
        (i, k, exact.t)
        for i, exact in enumerate(answers)
        if exact is not None and exact.t is not None and hit[i]
        for k in ([exact.prim] if answer.exact_visibility else exact.prims.tolist())
    ]
    if not members:
        return best, first
    owner, prim = np.array([each[:2] for each in members], np.int64).T
    at = near(owner, prim, np.array([float(t) for _, _, t in members]))
    rounding = np.broadcast_to(answer.t_rounding, answer.t.shape)[owner]
    pairs = zip(members, answer.t[owner].tolist(), strict=True)
    error = np.array([exact.off(t) if np.isfinite(t) else np.inf for (_, _, exact), t in pairs], np.float64)
    ratio = np.zeros(len(owner)) if answer.hits_only else ratio_to_bound(error, at.t_error + rounding)
    for _, ids, number in id_columns(answer, packed):
        ratio = np.where(ids[owner] == number(prim), ratio, np.inf)
    if answer.n is not None:
        bound = np.minimum(at.n_error, LARGEST_USEFUL_NORMAL_ERROR)
        ratio = np.maximum(ratio, ratio_to_bound(row_distance(answer.n[owner], at.n), bound))
    np.minimum.at(best, owner, ratio)
    begins = np.r_[True, np.diff(owner) != 0]
    first[owner[begins]] = ratio[begins] <= 1.0
    return best, first


@without_float_warnings
def ratio_to_bound(error: Array, bound: Array) -> Array:
    """error / bound; 0 where the bound is infinite, inf where the error is no number."""
    ratio = np.where(error == 0.0, 0.0, error / bound)
    return np.where(np.isnan(ratio), np.inf, ratio)


# ---- any float32 rays, for stress and bench


@dataclass(frozen=True)
class PreparedScene:
    """A scene, the model of its float32 numbers, and float32 rays through it."""

    scene: Scene
    model: SceneModel
    o: Array  # (n, 3) float32
    d: Array  # (n, 3) float32


def prepare_scene(scene: Scene, o: Array, d: Array) -> PreparedScene:
    return PreparedScene(scene, model_of(scene, endless_rays(o, d)), o, d)


class ExactHits:
    """Exact first hits of rays o + t d, t > 0; all arrays have one row a ray."""

    def __init__(self, model: SceneModel, o: Array, d: Array) -> None:
        self.model, self.o, self.d = model, o.astype(np.float64), d.astype(np.float64)
        self.answers = tuple(Oracle(model.packed).first_hits(self.o, self.d))
        self.prim, self.t = prims_and_t(self.answers)
        self.hit = self.prim >= 0

    def near(self, rows: Array | slice, prim: Array, t: Array, side: Side) -> Intersections:
        """Intersections of some rays with primitives, one each."""
        return intersections_at(self.model, prim, self.o[rows], self.d[rows], t, side)

    def ratios(self, answer: Answer, side: Side) -> Array:
        """(n,) error over bound, as by `exact_ratios`."""
        return exact_ratios(self.answers, answer, partial(self.near, side=side), self.model.packed)[0]

    def bounds(self, side: Side) -> Array:
        """(n,) bounds on |t - exact t| at the first primitive that is hit; NaN on a miss."""
        return np.where(self.hit, self.near(slice(None), self.prim, self.t, side).t_error, np.nan)

    def errors(self, t: Array) -> Array:
        """(n,) |t - exact t|, exactly rounded; NaN where either is not finite."""
        pairs = zip((answer.t for answer in self.answers), t.tolist(), strict=True)
        return np.array([np.nan if exact is None or not np.isfinite(x) else exact.off(x) for exact, x in pairs])

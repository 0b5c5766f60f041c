"""The class of every pixel of a candidate: Mitsuba names the surface, float64 says where it is, and exact arithmetic
who is right where that may matter (docs/method.md, "Candidates")."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from time import perf_counter

import numpy as np

from caster.rendering.images import Aovs, film_window
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import aov_rows, error_over_bound, intersections_at, row_distance
from mitsuba_ref.error_model.bracket import ANY_SHAPE, CLAIMED_MISS, NOT_CLAIMED, Bracket, Claims
from mitsuba_ref.error_model.intersections import KU, Intersections
from mitsuba_ref.error_model.scene_model import SceneModel
from mitsuba_ref.error_model.uncertain_rays import UncertainRaysModel, seen_by
from mitsuba_ref.judge.adjudication import Adjudication, claims_other_tie, needs_adjudication, oracle_answers
from mitsuba_ref.judge.classification import CLASS_CODE, EXACT, LARGEST_USEFUL_NORMAL_ERROR
from mitsuba_ref.judge.defect_features import FeatureMeasurement
from mitsuba_ref.judge.exact_share import ExactRatios, exact_ratios
from mitsuba_ref.judge.known_defects import defect_of
from mitsuba_ref.judge.verdict import (
    AGREE,
    EXPLAINED,
    OUT_OF_DOMAIN,
    REFERENCE_WRONG,
    TIE,
    UNDECIDED,
    WRONG,
)
from mitsuba_ref.oracle.oracle import ExactAnswer, Oracle
from mitsuba_ref.reference.rays import SharedRays
from mitsuba_ref.reference.rendering import ReferenceResult, aovs_of
from mitsuba_ref.subjects.answer import Answer

CLAIMED_AOVS = ("depth", "position", "normal", "shading_normal", "shape_id")  # of the reference


@dataclass(frozen=True)
class CandidateJudgement:
    """One row a pixel."""

    classes: np.ndarray  # (n,) index into CLASSES; WRONG is said of the candidate
    ratios: Mapping[str, np.ndarray]  # (n,) error over bound of each check
    exact: Adjudication
    cases: dict[int, int | None]  # pixel where the reference is wrong -> number of the known case
    exact_seconds: float

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.ratios)

    def ratio(self, name: str) -> np.ndarray:
        """(n,) error over bound of a check, `exact` included."""
        return self.ratios[name]

    def is_class(self, *names: str) -> np.ndarray:
        """(n,) bool: pixels of one of these classes."""
        return np.isin(self.classes, [CLASS_CODE[name] for name in names])

    def is_right(self, row: int) -> bool:
        """Whether exact arithmetic was asked about a row, and the candidate has its answer."""
        place = self.exact.place.get(row)
        return place is not None and bool(self.exact.right[place])


class CandidateJudge:
    """One scene, what Mitsuba and a candidate say of it, about to be judged."""

    def __init__(
        self, scene: Scene, model: SceneModel, rays: SharedRays, witness: ReferenceResult, answer: Answer
    ):
        self.scene, self.model, self.rays = scene, model, rays
        self.witness, self.answer = witness, answer
        self.o, self.d = rays.o.astype(np.float64), rays.d.astype(np.float64)
        self.t_max = rays.t_max.astype(np.float64)
        self.view = seen_by(answer, scene, model)
        self.prim = reference_prims(witness, model)
        self.mine = intersections_at(
            self.view, self.prim, (self.o, self.d), witness.t, answer.ku, ours=not answer.as_exported
        )
        self.at = intersections_at(model, self.prim, (self.o, self.d), witness.t, KU, ours=False)

    @cached_property
    def reference(self) -> Aovs:
        window = film_window(self.scene)
        return aovs_of(self.witness, self.rays, (window.height, window.width), CLAIMED_AOVS)

    @cached_property
    def bracket(self) -> Bracket:
        """What rounding allows the candidate."""
        view = self.view.refined() if isinstance(self.view, UncertainRaysModel) else self.view
        return Bracket(view, self.answer.ku, ours=not self.answer.as_exported)

    @cached_property
    def theirs(self) -> Bracket:
        """What rounding allows Mitsuba."""
        return Bracket(self.model, KU, ours=False)

    @cached_property
    def oracle(self) -> Oracle:
        return Oracle(self.model.packed)

    def judge(self) -> CandidateJudgement:
        """Plain agreement first; then everybody against the exact answer."""
        answer, ratios = self.answer, self._ratios()
        within = np.all([ratio <= 1.0 for ratio in ratios.values()], axis=0)
        vague = self._vague()
        plain = within & ~answer.is_broken & ~vague & self._reference_fits()
        certain = self.mine.certain & self.at.certain
        rows = needs_adjudication(plain, answer.hit, certain, self._shape())
        rows = rows[self.t_max[rows] >= 0.0]
        start = perf_counter()
        answers = oracle_answers(self.oracle, self.o[rows], self.d[rows], self.t_max[rows])
        seconds = perf_counter() - start
        share = exact_ratios(self, rows, answers)
        exact = Adjudication(rows, answers, share.best)
        classes = np.where(plain, CLASS_CODE[AGREE], CLASS_CODE[UNDECIDED])
        classes[rows] = self._settled(classes[rows], exact, share, vague[rows])
        no_ray = (self.t_max < 0.0) & answer.hit
        classes[answer.is_broken | no_ray] = CLASS_CODE[WRONG]
        ratios[EXACT] = np.zeros(len(classes))
        ratios[EXACT][rows] = np.where(exact.answered, exact.share, 0.0)
        for name in ratios:
            ratios[name][answer.is_broken] = np.inf
        cases = self._cases(np.flatnonzero(classes == CLASS_CODE[REFERENCE_WRONG]), exact)
        return CandidateJudgement(classes, ratios, exact, cases, seconds)

    def claims(self, rows: np.ndarray) -> Claims:
        """What the candidate says of some pixels: no shape, no shading normal, no position."""
        answer = self.answer
        shape = np.where(answer.hit[rows], ANY_SHAPE, CLAIMED_MISS)
        n = NOT_CLAIMED if answer.n is None else answer.n[rows]
        t_rounding = np.broadcast_to(answer.t_rounding, answer.t.shape)[rows]
        return Claims(answer.t[rows], shape, n, t_rounding=t_rounding)

    def _shape(self) -> tuple[int, int]:
        window = film_window(self.scene)
        return window.height, window.width

    def _ratios(self) -> dict[str, np.ndarray]:
        """(n,) of each check: the candidate against the surface that Mitsuba names, where float64 has it."""
        answer, mine = self.answer, self.mine
        both = answer.hit & self.witness.hit
        with np.errstate(invalid="ignore"):
            depth = error_over_bound(np.abs(answer.t - mine.t), mine.t_error + answer.t_rounding)
        depth = np.where(mine.possible, depth, np.inf)
        found = {
            "mask": np.where(answer.hit == self.witness.hit, 0.0, np.inf),
            "depth": np.where(both, depth, 0.0),
        }
        if answer.n is not None:
            turned = error_over_bound(row_distance(answer.n, mine.n), mine.n_error)
            found["normal"] = np.where(both, turned, 0.0)
        return found

    def _vague(self) -> np.ndarray:
        """(n,) bool: where t has no bound, or agreement of normals says nothing (VAGUE)."""
        both: np.ndarray = self.answer.hit & self.witness.hit
        return both & ~((self.mine.n_error <= LARGEST_USEFUL_NORMAL_ERROR) & np.isfinite(self.mine.t_error))

    def _reference_fits(self) -> np.ndarray:
        """(n,) bool: Mitsuba's own answer is at the surface that it names, so that naming it tells something."""
        at, witness = self.at, self.witness
        with np.errstate(invalid="ignore"):
            fits = at.possible & (np.abs(witness.t - at.t) <= at.t_error) & (witness.t > 0.0)
            fits &= row_distance(aov_rows(self.reference, "normal"), at.n) <= at.n_error
        return np.where(witness.hit, fits, True)

    def _settled(
        self, classes: np.ndarray, exact: Adjudication, share: ExactRatios, vague: np.ndarray
    ) -> np.ndarray:
        """The classes of the pixels that exact arithmetic was asked about."""
        rows, classes = exact.rows, classes.copy()
        disputed = classes != CLASS_CODE[AGREE]
        right = exact.right
        lost = np.flatnonzero(exact.answered & ~right)
        if len(lost):
            classes[lost] = self._excused(rows[lost], [exact.answers[int(i)] for i in lost])
        other = np.flatnonzero(right & disputed)
        if len(other):
            answers = [exact.answers[int(i)] for i in other]
            classes[other] = self._mitsubas(rows[other], vague[other], answers)
        classes[right & disputed & ~share.of_first] = CLASS_CODE[TIE]
        classes[~exact.answered] = CLASS_CODE[UNDECIDED]
        return classes

    def _excused(self, rows: np.ndarray, answers: Sequence[ExactAnswer | None]) -> np.ndarray:
        """Where the candidate is not exactly right: whether its own rounding allows what it says."""
        claims = self.claims(rows)
        found = self.bracket.judge(self.o[rows], self.d[rows], self.t_max[rows], claims)
        allowed = found.allowed & ((claims.shape == CLAIMED_MISS) | (claims.t > 0.0))
        classes = np.full(len(rows), CLASS_CODE[WRONG])
        lost = np.zeros(len(rows), bool)
        if isinstance(self.view, UncertainRaysModel):
            prim = np.array([-1 if answer is None else answer.prim for answer in answers])
            t = np.array([np.inf if a is None or a.t is None else float(a.t) for a in answers])
            lost = self.view.is_unresolved(prim, self.d[rows], t)
        classes[found.open | lost] = CLASS_CODE[OUT_OF_DOMAIN]
        classes[allowed] = CLASS_CODE[EXPLAINED]
        return classes

    def _mitsubas(
        self, rows: np.ndarray, vague: np.ndarray, answers: Sequence[ExactAnswer | None]
    ) -> np.ndarray:
        """Where the candidate is exactly right and does not plainly agree with Mitsuba: what becomes of Mitsuba."""
        o, d = self.o[rows], self.d[rows]
        claims = self._reference_claims(rows)
        found = self.theirs.judge(o, d, self.t_max[rows], claims)
        allowed = found.allowed & ((claims.shape < 0) | (claims.t > 0.0))
        classes = np.full(len(rows), CLASS_CODE[REFERENCE_WRONG])
        classes[found.open | (allowed & vague)] = CLASS_CODE[OUT_OF_DOMAIN]
        classes[allowed & ~vague] = CLASS_CODE[EXPLAINED]
        classes[claims_other_tie(self.model, o, d, claims, answers, LARGEST_USEFUL_NORMAL_ERROR)] = (
            CLASS_CODE[TIE]
        )
        return classes

    def _reference_claims(self, rows: np.ndarray) -> Claims:
        names = ("shape_id", "normal", "shading_normal", "position")
        return Claims(self.witness.t[rows], *(aov_rows(self.reference, name)[rows] for name in names))

    def _cases(self, rows: np.ndarray, exact: Adjudication) -> dict[int, int | None]:
        """Which known case of Mitsuba each pixel is where it is wrong."""
        if not len(rows):
            return {}
        answers = [answer for answer in map(exact.of, rows) if answer is not None]
        lines = self.o[rows], self.d[rows], self.t_max[rows]
        prims = [int(self.prim[row]) for row in rows]
        measured = FeatureMeasurement(self.model, self.oracle).all_of(
            lines, self._reference_claims(rows), answers, prims
        )
        return {int(row): defect_of(each) for row, each in zip(rows, measured, strict=True)}


def reference_prims(witness: ReferenceResult, model: SceneModel) -> np.ndarray:
    """(n,) the number in the scene of what Mitsuba says is hit, -1 on a miss.

    Of a shape with a stand-in, whose triangles Mitsuba counts by itself, the first primitive.
    """
    shape = witness.shape_id
    first, last = model.packed.first[shape], model.packed.first[shape + 1]
    prim = first + witness.answer.prim
    prim = np.where((prim >= first) & (prim < last), prim, first)
    return np.where(witness.hit & (shape >= 0), prim, -1).astype(np.int32)


def intersections_near(
    judge: CandidateJudge, rows: np.ndarray, prim: np.ndarray, t: np.ndarray
) -> Intersections:
    """Where rays of the picture meet these primitives as the candidate may see it, the root nearest to t."""
    line = judge.o[rows], judge.d[rows]
    return intersections_at(judge.view, prim, line, t, judge.answer.ku, ours=not judge.answer.as_exported)

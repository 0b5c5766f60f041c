"""A candidate at one pixel: it answers the whole image, as for `validate`, and is judged at this pixel only."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import aov_rows, row_distance
from mitsuba_ref.judge.adjudication import ratio_to_bound
from mitsuba_ref.judge.classification import Judge, Judgement, judge_of
from mitsuba_ref.judge.comparison import ImagePair
from mitsuba_ref.judge.diagnosis import diagnose, marked_miss
from mitsuba_ref.judge.explanations import exceeded_bounds, reason
from mitsuba_ref.judge.verdict import CLASSES, FAILING, UNDECIDED, UNLISTED
from mitsuba_ref.probe.witnesses import CANDIDATE, WitnessAnswer, with_error_of_t
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.subjects.requests import request_answer
from mitsuba_ref.subjects.subject import NoAnswer, Subject


@dataclass(frozen=True)
class CandidatePixel:
    """The verdict on one pixel of a candidate, and why."""

    name: str
    verdict: str
    precision: str = ""  # by whose bounds it is judged
    why: str = ""
    says: Mapping[str, Any] = field(default_factory=dict)  # hit, t, depth, normal, if given
    case: str = ""  # where the reference is wrong: the number of the known case, or "unlisted"
    notes: tuple[str, ...] = ()
    problem: str = ""  # why there is nothing to judge
    witness: WitnessAnswer | None = None  # its row among the witnesses

    @property
    def ok(self) -> bool:
        return not self.problem and self.verdict not in FAILING and self.case != UNLISTED

    def to_dict(self) -> dict[str, Any]:
        """For JSON, except that numbers may be infinite."""
        found = {name: value for name, value in vars(self).items() if name != "witness"}
        return found | {"ok": self.ok}


def probe_candidate(candidate: Subject, scene: Scene, pixel: tuple[int, int], pair: ImagePair) -> CandidatePixel:
    """Request the answer and judge it. pair: our answer and Mitsuba's along this pixel's ray. Raises SceneError."""
    x, y = pixel
    x0, y0, x1, y1 = scene.film.window
    if not (x0 <= x < x1 and y0 <= y < y1):
        x0, y0, x1, y1 = 0, 0, scene.film.width, scene.film.height
        scene = scene.with_film(crop=(x0, y0, x1, y1))
    row = (y - y0) * (x1 - x0) + x - x0
    try:
        response = request_answer(candidate, scene)
    except NoAnswer as error:
        witness = WitnessAnswer(CANDIDATE, "", -1, np.nan, problem="no answer")
        return CandidatePixel(candidate.name, UNDECIDED, problem=str(error), witness=witness)
    here = response._replace(
        scene=response.scene.with_film(crop=(x, y, x + 1, y + 1)),
        rays=response.rays.rows(slice(row, row + 1)),
        answer=response.answer.rows(slice(row, row + 1)),
    )
    judge = judge_of(here, known=pair)
    if isinstance(judge, Crash):
        return CandidatePixel(candidate.name, UNDECIDED, problem=judge.message)
    judgement, answer = judge.judge(), judge.answer
    witness, t = as_witness(judge, judgement), float(answer.t[0])
    diagnosed = diagnose(judge, judgement).by_row()
    if diagnosed and np.isfinite(t) and not judge.result.hit[0] and (response.answer.t == t).sum() > 1:
        diagnosed[0] = marked_miss(t)  # other rays have the same number
    shares = {"t": witness.share, "normal": witness.normal_share}
    exceeded = {"mask": float(judgement.ratios["mask"][0])} if not answer.is_broken[0] else {}
    exceeded |= {name: share for name, share in shares.items() if share is not None and exceeded}
    why = reason(judge, judgement, diagnosed, 0), exceeded_bounds(exceeded)
    return CandidatePixel(
        candidate.name,
        CLASSES[int(judgement.classes[0])],
        answer.precision,
        "; ".join(filter(None, why)),
        _answer_record(judge),
        case_text(judgement),
        (*answer.notes, *response.limits),
        witness=witness,
    )


def as_witness(judge: Judge, judgement: Judgement) -> WitnessAnswer:
    """The candidate's row among the witnesses: errors of t and of the normal, from the exact hit that fits best."""
    exact, answer = judgement.exact.of(0), judge.answer
    what, broken = "a hit" if answer.hit[0] else "miss", [*answer.broken]  # it names no shape
    claimed = WitnessAnswer(CANDIDATE, what, -1, float(answer.t[0]), format=answer.precision, remark=", ".join(broken))
    if exact is None:
        return claimed
    rows = np.zeros(len(exact.prims), int)
    at = judge.near(rows, exact.prims, np.full(len(rows), np.nan if exact.t is None else float(exact.t)))
    found = with_error_of_t(claimed, exact, at.t_error + np.ravel(answer.t_rounding)[0])
    if found.share is not None and answer.n is not None and not broken:
        shares = ratio_to_bound(row_distance(answer.n[rows], at.n), at.n_error)
        found = replace(found, normal_share=float(shares.min()))
    return replace(found, right=bool(judgement.is_right(0) and not broken))


def case_text(judgement: Judgement) -> str:
    """The number of the known defect where the reference is wrong, or "unlisted"; "" elsewhere."""
    if 0 not in judgement.cases:
        return ""
    case = judgement.cases[0]
    return UNLISTED if case is None else str(case)


def _answer_record(judge: Judge) -> dict[str, Any]:
    """The answer for JSON; the normal has length 1, or is NaN where it was not finite."""
    aovs, hit, t = judge.pair.subject, bool(judge.answer.hit[0]), float(judge.answer.t[0])
    names = [name for name in ("depth", "normal") if name in aovs and (hit or name == "depth")]
    return {"hit": hit, "t": t, "t_hex": t.hex()} | {name: aov_rows(aovs, name)[0].tolist() for name in names}

"""A candidate at one pixel, in the words of `validate`: it answers the whole image, all of which is judged."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import aov_rows, row_distance
from mitsuba_ref.judge.adjudication import ratio_to_bound
from mitsuba_ref.judge.classification import Judge, Judgement, judge_of
from mitsuba_ref.judge.diagnosis import diagnose
from mitsuba_ref.judge.explanations import exceeded_bounds, reason
from mitsuba_ref.judge.pipeline import Task, further_rays
from mitsuba_ref.judge.verdict import CLASSES, FAILING, UNDECIDED, UNLISTED, WRONG
from mitsuba_ref.probe.witnesses import CANDIDATE, WitnessAnswer, with_error_of_t
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT, SendRequest, send_stored
from mitsuba_ref.subjects.requests import request_answer
from mitsuba_ref.subjects.subject import NoAnswer, Subject


@dataclass(frozen=True, kw_only=True)
class Explained:
    """The class of one ray, and why."""

    verdict: str
    why: str = ""
    case: str = ""  # where the reference is wrong: the number of the known case, or "unlisted"
    problem: str = ""  # why there is nothing to judge

    @property
    def ok(self) -> bool:
        return not self.problem and self.verdict not in FAILING and self.case != UNLISTED


@dataclass(frozen=True, kw_only=True)
class CandidatePixel(Explained):
    """The verdict on one pixel of a candidate."""

    name: str
    precision: str = ""  # by whose bounds it is judged
    says: Mapping[str, Any] = field(default_factory=dict)  # hit, t, depth, normal, if given
    notes: tuple[str, ...] = ()
    witness: WitnessAnswer | None = None  # its row among the witnesses


def probe_candidate(
    candidate: Subject,
    scene: Scene,
    pixel: tuple[int, int],
    timeout: float = DEFAULT_TIMEOUT,
    send: SendRequest = send_stored,
) -> CandidatePixel:
    """Request the answer and judge it. timeout, send: as for `validate`. Raises SceneError."""
    window = window_of(candidate, scene, *pixel)
    try:
        response = request_answer(candidate, window)
    except NoAnswer as error:
        witness = WitnessAnswer(CANDIDATE, problem="no answer")
        return CandidatePixel(name=candidate.name, verdict=UNDECIDED, problem=str(error), witness=witness)
    judge = judge_of(response, timeout=timeout, send=send, with_files=False)
    if isinstance(judge, Crash):
        return CandidatePixel(name=candidate.name, verdict=UNDECIDED, problem=judge.message)
    x0, y0, x1, _ = window.film.window
    row = (pixel[1] - y0) * (x1 - x0) + pixel[0] - x0
    judgement, witness = judge.judge(), as_witness(judge, row)
    shares = {"mask": float(judgement.ratios["mask"][row]), "t": witness.share, "normal": witness.normal_share}
    exceeded = {name: share for name, share in shares.items() if share is not None and not witness.remark}
    diagnosis = diagnose(judge, judgement, further_rays(candidate, response.scene))
    why = filter(None, (reason(judge, judgement, diagnosis.by_row(), row), exceeded_bounds(exceeded)))
    left_out = row in judgement.not_adjudicated and witness.right is False  # but here it is adjudicated
    return CandidatePixel(
        name=candidate.name,
        verdict=WRONG if left_out else CLASSES[int(judgement.classes[row])],
        precision=judge.answer.precision,
        why="\n".join(["; ".join(why), *diagnosis.evidence_at(row)]),
        says=_answer_record(judge, row),
        case=case_text(judgement, row),
        notes=(*judge.answer.notes, *response.limits),
        witness=witness,
    )


def window_of(candidate: Subject, scene: Scene, x: int, y: int) -> Scene:
    """The scene with the window that `validate` judges this pixel in; with the whole film where the crop is without."""
    whole = scene.with_film(crop=(0, 0, scene.film.width, scene.film.height))
    windows = (window for film in (scene, whole) for window in Task(film, "", subject=candidate).windows())
    for window in windows:
        x0, y0, x1, y1 = window.film.window
        if x0 <= x < x1 and y0 <= y < y1:
            break
    return window


def as_witness(judge: Judge, row: int) -> WitnessAnswer:
    """The candidate's row among the witnesses: errors of t and of the normal, from the exact hit that fits best."""
    answer = judge.answer.rows(np.array([row]))
    what, t = "a hit" if answer.hit[0] else "miss", float(answer.t[0])  # it names no shape
    claimed = WitnessAnswer(CANDIDATE, what, -1, t, format=answer.precision, remark=", ".join(answer.broken))
    if judge.t_max[row] < 0.0:
        return claimed
    adjudicated = judge.adjudicated(np.array([row]))
    (exact,) = adjudicated.answers
    if exact is None:
        return claimed
    prims = exact.prims
    at = judge.near(np.full(len(prims), row), prims, np.full(len(prims), np.nan if exact.t is None else float(exact.t)))
    found = with_error_of_t(claimed, exact, at.t_error + answer.t_rounding)
    if found.share is not None and answer.n is not None and not found.remark:
        shares = ratio_to_bound(row_distance(answer.n.repeat(len(prims), axis=0), at.n), at.n_error)
        found = replace(found, normal_share=float(shares.min()))
    return replace(found, right=bool(adjudicated.right[0] and not found.remark))


def case_text(judgement: Judgement, row: int = 0) -> str:
    """The number of the known defect where the reference is wrong, or "unlisted"; "" elsewhere."""
    if row not in judgement.cases:
        return ""
    case = judgement.cases[row]
    return UNLISTED if case is None else str(case)


def _answer_record(judge: Judge, row: int) -> dict[str, Any]:
    """The answer for JSON; the normal has length 1, or is NaN where it was not finite."""
    aovs, hit, t = judge.pair.subject, bool(judge.answer.hit[row]), float(judge.answer.t[row])
    names = [name for name in ("depth", "normal") if name in aovs and (hit or name == "depth")]
    return {"hit": hit, "t": t} | {name: aov_rows(aovs, name)[row].tolist() for name in names}

"""A candidate at one pixel: its answer to the whole image, as `validate` requests it, judged at this pixel alone."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import aov_rows, row_distance
from mitsuba_ref.judge.aggregate import failure_hints
from mitsuba_ref.judge.classification import EXACT, Judge, Judgement, judge_of
from mitsuba_ref.judge.comparison import ImagePair
from mitsuba_ref.judge.diagnosis import diagnose, marked_miss
from mitsuba_ref.judge.explanations import exceeded_bounds, format_answer, not_compared, reason
from mitsuba_ref.judge.verdict import CLASSES, FAILING, UNDECIDED, UNLISTED
from mitsuba_ref.oracle.oracle import ExactAnswer
from mitsuba_ref.probe.witnesses import CANDIDATE, WitnessAnswer, in_ulps, ratio_to_bound
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.subjects.requests import SubjectResponse, one_of, request_answer
from mitsuba_ref.subjects.subject import Answer, NoAnswer, Subject


def errors_from_exact(judge: Judge, exact: ExactAnswer | None) -> dict[str, Any]:
    """How far t and the normal are from those of the exact answer, at the member of a tie that fits best.

    In units of the last place (t), as a share of its length (the normal), and of their bounds.
    """
    t = float(judge.answer.t[0])
    if exact is None or exact.t is None or not np.isfinite(t):
        return {}
    prim = np.array([each.prim for each in exact.ties])
    row = np.zeros(len(prim), int)
    at = judge.near(row, prim, np.full(len(prim), float(exact.t)))
    off = exact.t.off(t) * -exact.t.compare(t)
    t_share = [ratio_to_bound(abs(off), float(bound)) for bound in at.t_error + np.ravel(judge.answer.t_rounding)[0]]
    found: dict[str, Any] = {"t": off, "t_ulps": in_ulps(off, exact, np.dtype(judge.answer.precision))}
    if judge.answer.n is None or judge.answer.is_broken[0]:
        return found | {"t_share": min(t_share)}
    turned = row_distance(judge.answer.n[row], at.n)
    n_share = [ratio_to_bound(float(each), float(bound)) for each, bound in zip(turned, at.n_error, strict=True)]
    best = int(np.argmin(np.maximum(t_share, n_share)))
    return found | {
        "t_share": t_share[best],
        "normal": float(turned[best]),
        "normal_share": n_share[best],
        "exact_normal": at.n[best].tolist(),
    }


def exceeded_factors(judge: Judge, off: Mapping[str, Any], ratios: Mapping[str, float]) -> str:
    """By what factors: from the exact answer if there is one, else from Mitsuba's."""
    if judge.answer.is_broken[0]:
        return ""
    exact = {name: off[f"{name}_share"] for name in ("t", "normal") if f"{name}_share" in off}
    shares = {"mask": ratios["mask"]} | exact if exact else dict(ratios)
    return exceeded_bounds(shares)


def as_witness(judge: Judge, judgement: Judgement, off: Mapping[str, Any]) -> WitnessAnswer:
    """Beside ours and Mitsuba. off: from the exact answer."""
    answer = judge.answer
    broken = [*answer.broken]
    right = judgement.is_right(0) if judgement.exact.of(0) is not None else None
    return WitnessAnswer(
        CANDIDATE,
        "a hit" if answer.hit[0] else "miss",  # it names no shape
        -1,
        float(answer.t[0]),
        right=right and not broken,
        off=off.get("t"),
        ulps=off.get("t_ulps"),
        format=answer.precision,
        share=off.get("t_share"),
        normal_share=off.get("normal_share"),
        remark=", ".join(broken),
    )


CANDIDATE_QUANTITIES = ("t", "depth", "normal")  # of a hit


@dataclass(frozen=True)
class CandidatePixel:
    """What became of one pixel of a candidate, and why."""

    name: str  # who it is, as named
    verdict: str
    precision: str = ""  # whose bounds it is held to
    why: str = ""
    says: Mapping[str, Any] = field(default_factory=dict)  # hit, and of GIVES what there is
    off: Mapping[str, Any] = field(default_factory=dict)  # from the exact answer, where both hit
    ratios: Mapping[str, float] = field(default_factory=dict)  # error over bound, of what was judged
    not_judged: Mapping[str, str] = field(default_factory=dict)  # the rest, and why
    case: str = ""  # where the reference is wrong: the number of the known case, or "unlisted"
    alone: str = ""  # its answer to this ray alone
    notes: tuple[str, ...] = ()
    problem: str = ""  # why there is nothing to judge
    witness: WitnessAnswer | None = None  # the same, as a witness among the others

    @property
    def ok(self) -> bool:
        return not self.problem and self.verdict not in FAILING and self.case != UNLISTED

    def to_dict(self) -> dict[str, Any]:
        """For JSON, but for infinite numbers."""
        found = {name: value for name, value in vars(self).items() if name != "witness"}
        return found | {"ok": self.ok}


def probe_candidate(candidate: Subject, scene: Scene, pixel: tuple[int, int], pair: ImagePair) -> CandidatePixel:
    """Ask and judge. pair: ours and Mitsuba's answers along this pixel's ray. Raises SceneError."""
    x, y = pixel
    x0, y0, x1, y1 = scene.film.window
    if not (x0 <= x < x1 and y0 <= y < y1):
        x0, y0, x1, y1 = 0, 0, scene.film.width, scene.film.height
        scene = scene.with_film(crop=(x0, y0, x1, y1))
    row = (y - y0) * (x1 - x0) + x - x0
    try:
        response = request_answer(candidate, scene, alone=row)
    except NoAnswer as error:
        witness = WitnessAnswer(CANDIDATE, "", -1, np.nan, problem="no answer")
        return CandidatePixel(candidate.name, UNDECIDED, problem=str(error), witness=witness)
    here = response._replace(
        scene=response.scene.with_film(crop=(x, y, x + 1, y + 1)),
        rays=one_of(response.rays, row),
        answer=response.answer.rows(slice(row, row + 1)),
    )
    judge = judge_of(here, known=pair)
    if isinstance(judge, Crash):
        return CandidatePixel(candidate.name, UNDECIDED, problem=judge.message)
    return _judged(candidate.name, judge, response)


def case_text(judgement: Judgement) -> str:
    """Of a pixel where the reference is wrong: the number of the known case, or "unlisted"."""
    if 0 not in judgement.cases:
        return ""
    case = judgement.cases[0]
    return UNLISTED if case is None else str(case)


def _judged(name: str, judge: Judge, response: SubjectResponse) -> CandidatePixel:
    judgement, answer = judge.judge(), judge.answer
    verdict = CLASSES[int(judgement.classes[0])]
    diagnosed = diagnose(judge, judgement).by_row()
    if diagnosed and _marks_a_miss(judge, response.answer.t):
        diagnosed[0] = marked_miss(float(answer.t[0]))
    exact = judgement.exact.of(0)
    off = errors_from_exact(judge, exact)
    ratios = {check: float(ratio[0]) for check, ratio in judgement.ratios.items()}
    left = _not_judged(judge, exact)
    judged = {check: share for check, share in ratios.items() if check not in left or share > 0.0}
    why = (reason(judge, judgement, diagnosed, 0), exceeded_factors(judge, off, judged))
    return CandidatePixel(
        name,
        verdict,
        answer.precision,
        "; ".join(filter(None, why)),
        _answer_record(judge),
        off,
        judged,
        {check: why for check, why in left.items() if check not in judged},
        case_text(judgement),
        _answer_alone_text(response.alone, answer),
        (*answer.notes, *response.limits, *failure_hints(answer, judgement)),
        witness=as_witness(judge, judgement, off),
    )


def _marks_a_miss(judge: Judge, everywhere: np.ndarray) -> bool:
    """Whether t is a number in the place of inf: Mitsuba misses, and other rays have the very same one."""
    t = judge.answer.t[0]
    return bool(np.isfinite(t) and not judge.result.hit[0] and (everywhere == t).sum() > 1)


def _answer_record(judge: Judge) -> dict[str, Any]:
    """Numbers as they are; a normal of length 1, NaN where it was not finite."""
    aovs = judge.pair.subject
    given = {"t": judge.answer.t} | {name: aov_rows(aovs, name) for name in ("depth", "normal") if name in aovs}
    hit, t = bool(judge.answer.hit[0]), float(judge.answer.t[0])
    return {"hit": hit, "t_hex": t.hex()} | {
        name: values[0].tolist() for name, values in given.items() if hit or name != "normal"
    }


def _not_judged(judge: Judge, exact: ExactAnswer | None) -> dict[str, str]:
    hits = bool(judge.answer.hit[0]), bool(judge.result.hit[0])
    found = not_compared(*hits, "the candidate", ("depth", "normal"))
    if judge.answer.n is None:
        found["normal"] = "the candidate gives none"
    if exact is None:
        found[EXACT] = "there is no ray" if judge.t_max[0] < 0.0 else "exact arithmetic gave no answer"
    return found


def _answer_alone_text(alone: Answer | NoAnswer | None, together: Answer) -> str:
    if alone is None:
        return ""
    if isinstance(alone, NoAnswer):
        return f"no answer: {alone}"
    bits = [(each.t.tobytes(), None if each.n is None else each.n.tobytes()) for each in (alone, together)]
    same = bits[0] == bits[1] and [*alone.broken] == [*together.broken]
    return "the same, to the bit" if same else f"something else: {format_answer(alone, 0)}"

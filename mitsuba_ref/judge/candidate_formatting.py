"""What a candidate says of a pixel, in words, beside what Mitsuba and exact arithmetic say of it."""

import numpy as np

from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.error_model.intersections import KU, KU_OURS
from mitsuba_ref.judge.candidate_judge import CandidateJudge, CandidateJudgement, intersections_near
from mitsuba_ref.judge.classification import EXACT
from mitsuba_ref.judge.formatting import decimal_and_hex, exact_answer, format_exact
from mitsuba_ref.judge.verdict import CLASSES, FAILING, WRONG, Failure
from mitsuba_ref.reference.rays import pixel_of
from mitsuba_ref.subjects.answer import FLOAT32, Answer


def candidate_failure(judge: CandidateJudge, judgement: CandidateJudgement, row: int, why: str) -> Failure:
    """One pixel that fails."""
    x, y = pixel_of(judge.scene, row)
    ratios = {name: float(ratio[row]) for name, ratio in judgement.ratios.items()}
    telling = {name: share for name, share in ratios.items() if name != EXACT and not share <= 1.0}
    check = max(telling or ratios, key=lambda name: ratios[name])
    exact = format_exact(judge.scene, judge.model.packed, exact_answer(judge, judgement, row)) + exact_normal(
        judge, judgement, row
    )
    verdict = CLASSES[int(judgement.classes[row])]
    return Failure(
        x,
        y,
        verdict,
        check,
        ratios[check],
        format_candidate(judge, row),
        format_mitsuba(judge, row),
        exact,
        why,
    )


def format_candidate(judge: CandidateJudge, row: int) -> str:
    """What it says, and the ray."""
    along = f"along o ({format_numbers(judge.o[row])}), d ({format_numbers(judge.d[row])})"
    return f"{format_answer(judge.answer, row)}, {along}"


def format_answer(answer: Answer, row: int) -> str:
    """t to the bit and the normal, and what of it is no answer."""
    told = [f"t {decimal_and_hex(float(answer.t[row]))}" if answer.hit[row] else "miss"]
    if answer.n is not None and answer.hit[row]:
        told.append(f"n ({format_numbers(answer.n[row])})")
    told += [why for why, rows in answer.broken.items() if rows[row]]
    return ", ".join(told)


def format_mitsuba(judge: CandidateJudge, row: int) -> str:
    shape = int(judge.witness.shape_id[row])
    if shape < 0:
        return "miss"
    n = format_numbers(aov_rows(judge.reference, "normal")[row])
    return f"{judge.scene.shape_names()[shape]} at t {decimal_and_hex(float(judge.witness.t[row]))}, n ({n})"


def exact_normal(judge: CandidateJudge, judgement: CandidateJudgement, row: int) -> str:
    """Normals are not exact: float64's at the surface that is hit exactly."""
    answer = judgement.exact.of(row)
    if answer is None or answer.t is None or judge.answer.n is None:
        return ""
    one = np.array([row])
    at = intersections_near(judge, one, np.array([answer.prim]), np.array([float(answer.t)]))
    return f", n ({format_numbers(at.n[0])})"


def failure_hints(answer: Answer, judgement: CandidateJudgement) -> tuple[str, ...]:
    """What may help where pixels fail: bounds are as wide as the round-off they are made of."""
    wrong = judgement.is_class(WRONG)[judgement.exact.rows]
    if not judgement.is_class(*FAILING).any():
        return ()
    shares = judgement.exact.share[wrong]
    if answer.hints or answer.precision == FLOAT32 or not len(shares) or shares.max() > KU / KU_OURS:
        return answer.hints
    return (
        "every pixel that is wrong by the bounds of float64 is right by those of float32; if that will do: "
        "--candidate-precision float32",
    )


def format_numbers(values: np.ndarray) -> str:
    return ", ".join(f"{value:.9g}" for value in values)

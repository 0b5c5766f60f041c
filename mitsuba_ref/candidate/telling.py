"""What a candidate says of a pixel, in words, beside what Mitsuba and exact arithmetic say of it."""

import numpy as np

from mitsuba_ref.candidate.answer import FLOAT32, Answer
from mitsuba_ref.candidate.judge import CandidateJudge, CandidateJudgement, meets_again
from mitsuba_ref.judge import EXACT
from mitsuba_ref.meeting import KU, KU_OURS
from mitsuba_ref.pixels import flat
from mitsuba_ref.telling import asked, both, exact_words
from mitsuba_ref.verdict import CLASSES, FAILING, OURS_WRONG, Failure, pixel_of


def failure_at(judge: CandidateJudge, judgement: CandidateJudgement, row: int, why: str) -> Failure:
    """One pixel that fails."""
    x, y = pixel_of(judge.scene, row)
    ratios = {name: float(ratio[row]) for name, ratio in judgement.ratios.items()}
    telling = {name: share for name, share in ratios.items() if name != EXACT and not share <= 1.0}
    check = max(telling or ratios, key=lambda name: ratios[name])
    exact = exact_words(judge.scene, judge.model.packed, asked(judge, judgement, row)) + exact_normal(
        judge, judgement, row
    )
    verdict = CLASSES[int(judgement.classes[row])]
    return Failure(
        x,
        y,
        verdict,
        check,
        ratios[check],
        candidate_words(judge, row),
        mitsuba_words(judge, row),
        exact,
        why,
    )


def candidate_words(judge: CandidateJudge, row: int) -> str:
    """What it says, and the ray."""
    along = f"along o ({numbers(judge.o[row])}), d ({numbers(judge.d[row])})"
    return f"{answer_words(judge.answer, row)}, {along}"


def answer_words(answer: Answer, row: int) -> str:
    """t to the bit and the normal, and what of it is no answer."""
    told = [f"t {both(float(answer.t[row]))}" if answer.hit[row] else "miss"]
    if answer.n is not None and answer.hit[row]:
        told.append(f"n ({numbers(answer.n[row])})")
    told += [why for why, rows in answer.broken.items() if rows[row]]
    return ", ".join(told)


def mitsuba_words(judge: CandidateJudge, row: int) -> str:
    shape = int(judge.witness.shape_id[row])
    if shape < 0:
        return "miss"
    n = numbers(flat(judge.reference, "normal")[row])
    return f"{judge.scene.shape_names()[shape]} at t {both(float(judge.witness.t[row]))}, n ({n})"


def exact_normal(judge: CandidateJudge, judgement: CandidateJudgement, row: int) -> str:
    """Normals are not exact: float64's at the surface that is hit exactly."""
    answer = judgement.exact.of(row)
    if answer is None or answer.t is None or judge.answer.n is None:
        return ""
    one = np.array([row])
    at = meets_again(judge, one, np.array([answer.prim]), np.array([float(answer.t)]))
    return f", n ({numbers(at.n[0])})"


def hints(answer: Answer, judgement: CandidateJudgement) -> tuple[str, ...]:
    """What may help where pixels fail: bounds are as wide as the round-off they are made of."""
    wrong = judgement.is_class(OURS_WRONG)[judgement.exact.rows]
    if not judgement.is_class(*FAILING).any():
        return ()
    shares = judgement.exact.share[wrong]
    if answer.hints or answer.precision == FLOAT32 or not len(shares) or shares.max() > KU / KU_OURS:
        return answer.hints
    return (
        "every pixel that is wrong by the bounds of float64 is right by those of float32; if that will do: "
        "--candidate-precision float32",
    )


def numbers(values: np.ndarray) -> str:
    return ", ".join(f"{value:.9g}" for value in values)

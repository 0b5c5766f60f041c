"""Why a pixel of a candidate has its class, in a sentence."""

from collections.abc import Mapping

from mitsuba_ref.judge.candidate_judge import CandidateJudge, CandidateJudgement
from mitsuba_ref.judge.formatting import format_defect
from mitsuba_ref.judge.verdict import AGREE, CLASSES, EXPLAINED, OUT_OF_DOMAIN, REFERENCE_WRONG, TIE

WHY = {
    AGREE: "all that is given is within the bounds of the candidate's arithmetic",
    TIE: "several primitives are hit at exactly this t, and any of them is a right answer",
}

RIGHT = {
    EXPLAINED: "the candidate is exactly right, and rounding in float32 allows Mitsuba's answer, too",
    OUT_OF_DOMAIN: "the candidate is exactly right; float32, in which Mitsuba computes, cannot resolve this pixel",
}


def reason(judge: CandidateJudge, judgement: CandidateJudgement, said: Mapping[int, str], row: int) -> str:
    """Of one row of the picture. said: row that fails -> what is wrong there."""
    verdict = CLASSES[int(judgement.classes[row])]
    if row in said:
        return said[row]
    if verdict in WHY:
        return WHY[verdict]
    if verdict == REFERENCE_WRONG:
        case = format_defect(judgement.cases.get(row))
        return f"the candidate is right, and Mitsuba's answer is beyond what float32 allows; {case}"
    if judgement.is_right(row):
        return RIGHT[verdict]
    precision = judge.answer.precision
    return {
        EXPLAINED: f"rounding in {precision} allows what the candidate says, which is not the exact answer",
        OUT_OF_DOMAIN: f"{precision}, in which the candidate computes, cannot resolve this pixel",
    }[verdict]

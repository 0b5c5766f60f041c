"""Why a pixel has its class, in a sentence."""

from mitsuba_ref.judge import Judge, Judgement
from mitsuba_ref.telling import case_words
from mitsuba_ref.verdict import (
    AGREE,
    CLASSES,
    EXPLAINED,
    OURS_WRONG,
    OUT_OF_DOMAIN,
    REFERENCE_WRONG,
    TIE,
)

WHY = {
    AGREE: "every quantity is within its bound",
    EXPLAINED: "ours is exactly right, and rounding in float32 allows Mitsuba's answer, too",
    TIE: "several primitives are hit at exactly this t; ours is the first of them, Mitsuba's is another",
    OUT_OF_DOMAIN: "ours is exactly right; float32 cannot resolve this pixel",
}


def reason(judge: Judge, judgement: Judgement, row: int) -> str:
    """Of one row of the picture."""
    verdict = CLASSES[int(judgement.classes[row])]
    if verdict == REFERENCE_WRONG:
        case = case_words(judgement.cases.get(row))
        return f"ours is right, and Mitsuba's answer is beyond what float32 allows; {case}"
    if verdict == OURS_WRONG:
        return _what_is_wrong(judgement, row)
    return WHY.get(verdict) or _what_is_open(judge, judgement, row)


def _what_is_wrong(judgement: Judgement, row: int) -> str:
    if not judgement.exact_ratio[row] <= 1.0:
        return "by exact arithmetic, ours is wrong"
    return "ours is beyond what float64 rounding allows at the primitive that is hit"


def _what_is_open(judge: Judge, judgement: Judgement, row: int) -> str:
    told = [name for name, where in judge.contradictions.items() if where[row]]
    if told:
        return f"our picture contradicts our own hit: {', '.join(told)}"
    worst = max(judgement.names, key=lambda name: judgement.excess(name)[row])
    if judgement.excess(worst)[row] > 1.0 >= judgement.ratio(worst)[row]:
        return f"beyond the share of the bound that [check.{worst}] allows"
    if judgement.exact.of(row) is None:
        return "exact arithmetic gave no answer"
    return "no shadow that rounding allows gives this value, and nothing shows whose fault that is"

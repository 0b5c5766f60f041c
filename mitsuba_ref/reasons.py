"""Why a pixel has its class, in a sentence."""

from mitsuba_ref.judge import Judge, Judgement
from mitsuba_ref.quantities import beyond, own_shares, shares
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


def why(judge: Judge, judgement: Judgement, row: int) -> str:
    """The reason, and which quantities are beyond their bounds by what factor."""
    told = beyond(shares(judge, judgement, row))
    return "; ".join(filter(None, (reason(judge, judgement, row), told)))


def reason(judge: Judge, judgement: Judgement, row: int) -> str:
    """Of one row of the picture; the same words for many pixels."""
    verdict = CLASSES[int(judgement.classes[row])]
    if verdict == REFERENCE_WRONG:
        case = case_words(judgement.cases.get(row))
        return f"ours is right, and Mitsuba's answer is beyond what float32 allows; {case}"
    if verdict == OURS_WRONG:
        return _what_is_wrong(judge, judgement, row)
    return WHY.get(verdict) or _what_is_open(judge, judgement, row)


def _what_is_wrong(judge: Judge, judgement: Judgement, row: int) -> str:
    if not judgement.exact_ratio[row] <= 1.0:
        return f"by exact arithmetic, ours is wrong: {_how(judge, judgement, row)}"
    names = " and ".join(own_shares(judge, row)) or "diffuse"
    return f"ours is beyond what float64 rounding allows at the primitive that is hit, in {names}"


def _how(judge: Judge, judgement: Judgement, row: int) -> str:
    answer, prim = judgement.exact.of(row), int(judge.pair.prim[row])
    right = -1 if answer is None else answer.prim
    if prim == right:
        return "t is off"
    if right < 0:
        return "it hits where nothing is"
    return "it misses what is hit" if prim < 0 else "it hits another primitive than the first one"


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

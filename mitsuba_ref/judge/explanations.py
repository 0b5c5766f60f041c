"""The quantities of one pixel in words: which are beyond their bounds, and by what factor; which were not judged."""

from collections.abc import Mapping

import numpy as np

from mitsuba_ref.judge.classification import EXACT, Judge, Judgement
from mitsuba_ref.judge.formatting import format_defect
from mitsuba_ref.judge.verdict import (
    AGREE,
    CLASSES,
    EXPLAINED,
    JUDGED_WITHOUT_REFERENCE,
    OUT_OF_DOMAIN,
    REFERENCE_WRONG,
    TIE,
    UNDECIDED,
    WRONG,
)

QUANTITY_NAMES = {EXACT: "t by exact arithmetic", "mask": "hit or miss", "shape_id": "the shape"}
COMPARED_AT_HITS = ("depth", "position", "normal", "shading_normal")  # compared where both sides hit


def error_ratios(judge: Judge, judgement: Judgement, row: int) -> dict[str, float]:
    """Error over bound of every quantity of ours, against Mitsuba or against float64 alone, whichever is more."""
    found = {name: float(judgement.ratio(name)[row]) for name in judgement.names}
    for name, share in self_check_ratios(judge, row).items():
        found[name] = max(found[name], share)
    return found


def self_check_ratios(judge: Judge, row: int) -> dict[str, float]:
    """Of what is beyond float64's bound at our own primitive."""
    found = {}
    for each in judge.held:
        if each.is_beyond(row):
            error, bound = float(each.error[row]), float(each.bound[row])
            found[each.name] = error / bound if bound > 0.0 and np.isfinite(error) else np.inf
    return found


def exceeded_bounds(shares: Mapping[str, float]) -> str:
    """Which are beyond their bounds, and by what factor; "" where none is.

    A hit in place of a miss has no factor. That t is not the exact one says the least, where it has none either.
    """
    found = {name: share for name, share in shares.items() if not share <= 1.0}
    if len(found) > 1 and not np.isfinite(found.get(EXACT, 0.0)):
        del found[EXACT]
    factors = {name: f" {share:.3g}x" if np.isfinite(share) else "" for name, share in found.items()}
    told = [f"{QUANTITY_NAMES.get(name, name)}{factor}" for name, factor in factors.items()]
    return f"beyond {'its bound' if len(told) == 1 else 'their bounds'}: {', '.join(told)}" if told else ""


def not_judged(judge: Judge, judgement: Judgement, row: int) -> dict[str, str]:
    """What was not judged of ours, and why: a share of 0 would pass for agreement."""
    ours, theirs = bool(judge.pair.ours.hit.ravel()[row]), bool(judge.pair.reference.hit.ravel()[row])
    found = not_compared(ours, theirs, "ours", COMPARED_AT_HITS)
    if not ours:
        found["on_surface"] = "ours hits nothing"
    if why := _diffuse(judge, judgement, row):
        found["diffuse"] = why
    if judgement.exact.of(row) is None:
        found[EXACT] = "there is no ray" if judge.t_max[row] < 0.0 else "exact arithmetic gave no answer"
    # What contradicts something else is told as beyond all bounds, whatever else was not judged.
    return {name: why for name, why in found.items() if not judgement.ratio(name)[row] > 0.0}


def not_compared(judged: bool, reference: bool, who: str, names: tuple[str, ...]) -> dict[str, str]:
    """Why these are not compared, where the one who is judged or Mitsuba misses; nothing where both hit."""
    if judged and reference:
        return {}
    why = f"{who if judged else 'Mitsuba'} alone hits" if judged or reference else "nothing is hit"
    return dict.fromkeys(names, why)


def _diffuse(judge: Judge, judgement: Judgement, row: int) -> str:
    """Light is compared with Mitsuba's where geometry agrees, and else held to float64 where ours is right."""
    name = CLASSES[int(judgement.classes[row])]
    if not judge.pair.ours.hit.ravel()[row]:
        return "ours hits nothing"
    if name == AGREE:
        return ""
    if name not in JUDGED_WITHOUT_REFERENCE:
        already = "undecided" if name == UNDECIDED else "wrong"
        return f"what is hit, or where, is {already} already"
    if not np.isfinite(judge.bounds.own.t_error[row]):
        return "float64 does not resolve where the hit is"
    return "not against Mitsuba's, which is of another surface or place; it is what float64 gives on ours"


# Why a pixel has its class, in a sentence.


CONSTANT_REASONS = {
    AGREE: "every quantity is within its bound",
    EXPLAINED: "ours is exactly right, and rounding in float32 allows Mitsuba's answer, too",
    TIE: "several primitives are hit at exactly this t; ours is the first of them, Mitsuba's is another",
    OUT_OF_DOMAIN: "ours is exactly right; float32 cannot resolve this pixel",
}


def reason_with_factors(judge: Judge, judgement: Judgement, row: int) -> str:
    """The reason, and which quantities are beyond their bounds by what factor."""
    told = exceeded_bounds(error_ratios(judge, judgement, row))
    return "; ".join(filter(None, (reason(judge, judgement, row), told)))


def reason(judge: Judge, judgement: Judgement, row: int) -> str:
    """Of one row of the picture; the same words for many pixels."""
    verdict = CLASSES[int(judgement.classes[row])]
    if verdict == REFERENCE_WRONG:
        case = format_defect(judgement.cases.get(row))
        return f"ours is right, and Mitsuba's answer is beyond what float32 allows; {case}"
    if verdict == WRONG:
        return _what_is_wrong(judge, judgement, row)
    return CONSTANT_REASONS.get(verdict) or _what_is_open(judge, judgement, row)


def _what_is_wrong(judge: Judge, judgement: Judgement, row: int) -> str:
    if not judgement.exact_ratio[row] <= 1.0:
        return f"by exact arithmetic, ours is wrong: {_how(judge, judgement, row)}"
    names = " and ".join(self_check_ratios(judge, row)) or "diffuse"
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

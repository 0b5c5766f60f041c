"""Explanations: why a pixel has its class, which quantities exceed their bounds, and which were not compared."""

from collections.abc import Mapping

import numpy as np

from mitsuba_ref.judge.classification import EXACT, Judge, Judgement
from mitsuba_ref.judge.known_defects import defect_name
from mitsuba_ref.judge.verdict import (
    AGREE,
    CLASSES,
    EXPLAINED,
    JUDGED_WITHOUT_REFERENCE,
    OUT_OF_DOMAIN,
    REFERENCE_WRONG,
    TIE,
    UNDECIDED,
    UNLISTED,
)

QUANTITY_NAMES = {EXACT: "t by exact arithmetic", "mask": "hit or miss", "shape_id": "the shape"}
COMPARED_AT_HITS = ("depth", "position", "normal", "shading_normal")  # compared where both sides hit


def subject_name(judge: Judge) -> str:
    """In a sentence."""
    return "ours" if judge.answer.exact_visibility else "the candidate"


def constant_reasons(judge: Judge) -> dict[str, str]:
    """The classes whose reason is the same at every pixel."""
    if not judge.answer.exact_visibility:
        return {
            AGREE: "all that is given is within the bounds of the candidate's arithmetic",
            TIE: "several primitives are hit at exactly this t, and any of them is a right answer",
        }
    return {
        AGREE: "every quantity is within its bound",
        EXPLAINED: "ours is exactly right, and rounding in float32 allows Mitsuba's answer, too",
        TIE: "several primitives are hit at exactly this t; ours is the first of them, Mitsuba's is another",
        OUT_OF_DOMAIN: "ours is exactly right; float32 cannot resolve this pixel",
    }


def reason(judge: Judge, judgement: Judgement, diagnosed: Mapping[int, str], row: int) -> str:
    """Why a row of the image has its class; the same words for many pixels. diagnosed: row that fails -> diagnosis."""
    verdict = CLASSES[int(judgement.classes[row])]
    if verdict == REFERENCE_WRONG:
        defect = format_defect(judgement.cases.get(row))
        return f"{subject_name(judge)} is right, and Mitsuba's answer is beyond what float32 allows; {defect}"
    if row in diagnosed:
        return diagnosed[row]
    constant = constant_reasons(judge).get(verdict)
    return constant or _rounding_reason(judge, judgement, verdict, row)


def _rounding_reason(judge: Judge, judgement: Judgement, verdict: str, row: int) -> str:
    """Whose rounding excuses a pixel: of a subject whose own visibility is rounded, it may be the subject's."""
    precision = judge.answer.precision
    if judgement.is_right(row):
        return {
            EXPLAINED: "the candidate is exactly right, and rounding in float32 allows Mitsuba's answer, too",
            OUT_OF_DOMAIN: "the candidate is exactly right; float32, in which Mitsuba computes, cannot resolve this "
            "pixel",
        }[verdict]
    return {
        EXPLAINED: f"rounding in {precision} allows the candidate's answer, which is not the exact one",
        OUT_OF_DOMAIN: f"{precision}, in which the candidate computes, cannot resolve this pixel",
    }[verdict]


def open_reason(judge: Judge, judgement: Judgement, row: int) -> str:
    """Why a row of the image is undecided."""
    inconsistent = [name for name, where in judge.inconsistent.items() if where[row]]
    if inconsistent:
        return f"our image contradicts our own hit: {', '.join(inconsistent)}"
    worst = max(judgement.names, key=lambda name: judgement.excess(name)[row])
    if judgement.excess(worst)[row] > 1.0 >= judgement.ratio(worst)[row]:
        return f"beyond the share of the bound that [check.{worst}] allows"
    if judgement.exact.of(row) is None:
        return "exact arithmetic gave no answer"
    return "no shadow that rounding allows gives this value, and nothing shows whose fault that is"


def format_defect(case: int | None) -> str:
    """A known defect with its number."""
    if case is None:
        return f"{UNLISTED}: none of the cases that are known"
    return f"case {case}: {defect_name(case)}"


def full_reason(judge: Judge, judgement: Judgement, diagnosed: Mapping[int, str], row: int) -> str:
    """The reason, and which quantities exceed their bounds by what factor."""
    exceeded = exceeded_bounds(error_ratios(judge, judgement, row))
    return "; ".join(filter(None, (reason(judge, judgement, diagnosed, row), exceeded)))


def error_ratios(judge: Judge, judgement: Judgement, row: int) -> dict[str, float]:
    """Error over bound of every quantity, from Mitsuba or from the subject's own primitive, whichever is more."""
    found = {name: float(judgement.ratio(name)[row]) for name in judgement.names}
    for check in judge.self_checks:
        if check.fails_at(row):
            error, bound = float(check.error[row]), float(check.bound[row])
            own = error / bound if bound > 0.0 and np.isfinite(error) else np.inf
            found[check.name] = max(found[check.name], own)
    return found


def exceeded_bounds(ratios: Mapping[str, float]) -> str:
    """Which quantities exceed their bounds, and by what factor; "" where none does.

    A hit in place of a miss has no factor. That t is not the exact one is the least specific, where it has none either.
    """
    found = {name: ratio for name, ratio in ratios.items() if not ratio <= 1.0}
    if len(found) > 1 and not np.isfinite(found.get(EXACT, 0.0)):
        del found[EXACT]
    factors = {name: f" {ratio:.3g}x" if np.isfinite(ratio) else "" for name, ratio in found.items()}
    words = [f"{QUANTITY_NAMES.get(name, name)}{factor}" for name, factor in factors.items()]
    return f"beyond {'its bound' if len(words) == 1 else 'their bounds'}: {', '.join(words)}" if words else ""


def not_judged(judge: Judge, judgement: Judgement, row: int) -> dict[str, str]:
    """Quantities of our caster that were not compared, and why: a ratio of 0 would pass for agreement."""
    ours, theirs = bool(judge.hit[row]), bool(judge.pair.reference.hit.ravel()[row])
    found = not_compared(ours, theirs, "ours", COMPARED_AT_HITS)
    if not ours:
        found["on_surface"] = "ours hits nothing"
    if why := _diffuse(judge, judgement, row):
        found["diffuse"] = why
    if judgement.exact.of(row) is None:
        found[EXACT] = "there is no ray" if judge.t_max[row] < 0.0 else "exact arithmetic gave no answer"
    # What contradicts something else is reported as beyond all bounds, whatever else was not compared.
    return {name: why for name, why in found.items() if not judgement.ratio(name)[row] > 0.0}


def not_compared(subject: bool, reference: bool, who: str, names: tuple[str, ...]) -> dict[str, str]:
    """Why these are not compared where the subject or Mitsuba misses; nothing where both hit."""
    if subject and reference:
        return {}
    why = f"{who if subject else 'Mitsuba'} alone hits" if subject or reference else "nothing is hit"
    return dict.fromkeys(names, why)


def _diffuse(judge: Judge, judgement: Judgement, row: int) -> str:
    """Light is compared with Mitsuba's where geometry agrees, and else held to float64 where ours is right."""
    name = CLASSES[int(judgement.classes[row])]
    if not judge.hit[row]:
        return "ours hits nothing"
    if name == AGREE:
        return ""
    if name not in JUDGED_WITHOUT_REFERENCE:
        already = "undecided" if name == UNDECIDED else "wrong"
        return f"what is hit, or where, is {already} already"
    if not np.isfinite(judge.bounds.own.t_error[row]):
        return "float64 does not resolve where the hit is"
    return "not against Mitsuba's, which is of another surface or place; it is what float64 gives on ours"

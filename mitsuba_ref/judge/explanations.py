"""Explanations in words: the reason for a pixel's class, the bounds it exceeds, and every answer at the pixel."""

from collections.abc import Iterator, Mapping

import numpy as np

from caster.aovs import Aovs
from caster.geometry.packing import Packed
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.judge.adjudication import named_prims
from mitsuba_ref.judge.classification import EXACT, Judge, Judgement
from mitsuba_ref.judge.defect_lookup import defect_name
from mitsuba_ref.judge.verdict import AGREE, CLASSES, EXPLAINED, REFERENCE_WRONG, TIE, UNLISTED
from mitsuba_ref.oracle.oracle import ExactAnswer

QUANTITY_NAMES = {EXACT: "t by exact arithmetic", "mask": "hit or miss", "shape_id": "the shape"}


def subject_name(judge: Judge) -> str:
    """The subject's name in a sentence."""
    return "ours" if judge.answer.exact_visibility else "the candidate"


# Classes whose reason is the same at every pixel.
ALIKE_REASONS = {
    AGREE: "every quantity is within its bound",
    TIE: "several primitives are hit at exactly this t, and each side reports one, or the ray starts on one",
}


def reason(judge: Judge, judgement: Judgement, diagnosed: Mapping[int, str], row: int) -> str:
    """The reason for the class of a row of the image. diagnosed: the diagnosis of each failing row."""
    verdict = CLASSES[int(judgement.classes[row])]
    if verdict == REFERENCE_WRONG:
        defect = format_defect(judgement.cases.get(row))
        return f"{subject_name(judge)} is right, and Mitsuba's answer is beyond what float32 allows; {defect}"
    if row in diagnosed:
        return diagnosed[row]
    light = judgement.ratios.get("diffuse")  # compared where both see the same surface; no candidate gives it
    if verdict == EXPLAINED and light is not None and light[row] > 1.0:
        return "a shadow: both sides see the same point, and rounding allows a light to be visible there or not"
    if verdict in ALIKE_REASONS:
        return ALIKE_REASONS[verdict]
    who, precision = subject_name(judge), judge.answer.precision
    explained = f"{who} is exactly right, and rounding in float32 allows Mitsuba's answer, too"
    unresolved = f"{who} is exactly right; float32, in which Mitsuba computes, cannot resolve this pixel"
    if not (judge.answer.exact_visibility or judgement.exact.right[judgement.exact.rows == row].any()):
        explained = f"rounding in {precision} allows the candidate's answer, which is not the exact one"
        unresolved = f"{precision}, in which the candidate computes, cannot resolve this pixel"
    return explained if verdict == EXPLAINED else unresolved


def open_reason(judge: Judge, judgement: Judgement, row: int) -> str:
    """Why a row of the image is undecided."""
    inconsistent = [name for name, where in judge.inconsistent.items() if where[row]]
    if inconsistent:
        return f"our image contradicts our own hit: {', '.join(inconsistent)}"
    worst = max(judgement.ratios, key=lambda name: judgement.excess(name)[row])
    if judgement.excess(worst)[row] > 1.0 >= judgement.ratios[worst][row]:
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
    """The reason; of a subject that names primitives, also the quantities beyond their bounds with their factors."""
    found = [reason(judge, judgement, diagnosed, row)]
    if judge.names_prims:
        found.append(exceeded_bounds({name: float(ratio[row]) for name, ratio in judgement.ratios.items()}))
    return "; ".join(filter(None, found))


def exceeded_bounds(ratios: Mapping[str, float]) -> str:
    """The quantities beyond their bounds, with factors; "" if there is none.

    A hit in place of a miss has no factor. A wrong exact t without a factor is left out if others are wrong.
    """
    found = {name: ratio for name, ratio in ratios.items() if not ratio <= 1.0}
    if len(found) > 1 and not np.isfinite(found.get(EXACT, 0.0)):
        del found[EXACT]
    factors = {name: f" {ratio:.3g}x" if np.isfinite(ratio) else "" for name, ratio in found.items()}
    words = [f"{QUANTITY_NAMES.get(name, name)}{factor}" for name, factor in factors.items()]
    return f"beyond {'its bound' if len(words) == 1 else 'their bounds'}: {', '.join(words)}" if words else ""


# ---- answers of a pixel: shape and t, in decimal and to the bit ----

MAX_TIES_SHOWN = 6  # members of an exact tie set on one line; JSON has all
AOVS_SHOWN = ("position", "shading_normal", "uv", "diffuse")  # if compared, beside shape, t and normal


def tie_members(scene: Scene, packed: Packed, answer: ExactAnswer) -> list[tuple[str, int, str]]:
    """(shape, number within it, where) of each primitive of the exact tie set."""
    named = zip(named_prims(scene, packed, answer.prims), answer.ties, strict=True)
    return [(*surface, hit.where) for surface, hit in named]


def format_exact(scene: Scene, packed: Packed, answer: ExactAnswer | None, *, with_t: bool = True) -> str:
    """The exact answer on one line."""
    if answer is None:
        return "no answer"
    if answer.t is None:
        return "miss"
    ties = [f"{shape}, prim {prim} ({where})" for shape, prim, where in tie_members(scene, packed, answer)]
    if len(ties) > MAX_TIES_SHOWN:
        ties[MAX_TIES_SHOWN:] = [f"{len(ties) - MAX_TIES_SHOWN} more"]
    at = f" at t {decimal_and_hex(float(answer.t))}" if with_t else ""
    return f"{' = '.join(ties)}{at}"


def exact_answer(judge: Judge, judgement: Judgement, row: int) -> ExactAnswer | None:
    """The exact answer at a row, computed now if it is not known; None if there is no ray."""
    known = judgement.exact.of(row)
    if known is not None or judge.t_max[row] < 0.0:
        return known
    return judge.adjudicated(np.array([row])).answers[0]


def pixel_answers(judge: Judge, judgement: Judgement, row: int, check: str) -> tuple[str, str, str]:
    """The subject's, the reference's and the exact answer at one row of the image. check: whose values are shown."""
    exact = format_exact(judge.scene, judge.model.packed, exact_answer(judge, judgement, row))
    rows = np.array([row])
    prim, t = judgement.exact.first_hits(rows)
    if prim[0] >= 0 and judge.n is not None:  # in float64 at the surface that is hit: normals have no exact value
        exact += f", n ({format_numbers(judge.near(rows, prim, t).n[0])})"
    subject = _aovs_text(judge, judge.subject, judge.answer.t, row, check)
    broken = [why for why, where in judge.answer.broken.items() if where[row]]
    ray = f"along o ({format_numbers(judge.o[row])}), d ({format_numbers(judge.d[row])})"
    reference = _aovs_text(judge, judge.pair.reference, judge.result.t, row, check)
    return ", ".join([subject, *broken, ray]), reference, exact


def _aovs_text(judge: Judge, aovs: Aovs, t: Array, row: int, check: str) -> str:
    """The shape if it is named, t, the normal, and the value that was compared."""
    if not aovs.hit.ravel()[row]:
        return "miss"
    shape = int(aov_rows(aovs, "shape_id")[row]) if judge.names_prims or aovs is judge.pair.reference else -1
    name = f"{judge.scene.shape_names()[shape]} at " if shape >= 0 else ""
    text = f"{name}t {decimal_and_hex(float(t[row]))}"
    if "normal" in aovs:
        text += f", n ({format_numbers(aov_rows(aovs, 'normal')[row])})"
    if check in AOVS_SHOWN and check in aovs:
        text += f", {check} ({', '.join(map(repr, aov_rows(aovs, check)[row].tolist()))})"
    return text


def reproducer_header(judge: Judge, judgement: Judgement, row: int, what: str, source: str) -> Iterator[str]:
    """Comment lines of a reproducer: every answer at a row of the image, and how to see it again."""
    light = judgement.ratios.get("diffuse")
    check = "diffuse" if light is not None and light[row] > 1.0 else EXACT
    subject, reference, exact = pixel_answers(judge, judgement, row, check)
    yield f"One ray that was judged: {what}."
    yield ""
    yield f"from:      {source}"
    yield f"exact:     {exact}"
    yield f"answer:    {subject}"
    yield f"Mitsuba:   {reference}"
    yield f"versions:  {', '.join(f'{name} {version}' for name, version in judge.result.answer.versions.items())}"
    yield "All numbers of the geometry are float32 values with all their digits. t counts in lengths of the direction."
    yield "See it:    mitsuba-ref probe THIS-FILE 0 0"
    mode = str(judge.result.robust).lower()
    yield f"Mitsuba:   scene.ray_intersect; optimize=False; embree_use_robust_intersections={mode}"
    yield "           mitsuba-ref export THIS-FILE -o DIR writes the XML and the meshes"
    yield ""


def decimal_and_hex(value: float) -> str:
    return f"{value!r} {value.hex()}"


def format_numbers(values: Array) -> str:
    """Decimals, nine digits, of a few numbers."""
    return ", ".join(f"{value:.9g}" for value in values)

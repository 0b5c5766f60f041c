"""Explanations in words: the reason for a pixel's class, the bounds it exceeds, and every answer at the pixel."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from caster.geometry.packing import Packed
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.judge.adjudication import named_prims
from mitsuba_ref.judge.classification import CLASS_CODE, EXACT, Judge, Judgement
from mitsuba_ref.judge.defect_lookup import defect_name
from mitsuba_ref.judge.verdict import AGREE, CLASSES, EXPLAINED, OUT_OF_DOMAIN, REFERENCE_WRONG, TIE, UNLISTED
from mitsuba_ref.oracle.oracle import ExactAnswer

QUANTITY_NAMES = {EXACT: "t by exact arithmetic", "mask": "hit or miss", "shape_id": "the shape"}
COMPARED_AT_HITS = ("depth", "position", "normal", "shading_normal", "uv")  # only where both sides hit


def subject_name(judge: Judge) -> str:
    """The subject's name in a sentence."""
    return "ours" if judge.answer.exact_visibility else "the candidate"


def _reasons(judge: Judge, *, right: bool) -> dict[str, str]:
    """Reasons of classes that pass. right: the subject has the exact answer, as ours has wherever it passes."""
    if judge.answer.exact_visibility:
        agree = "every quantity is within its bound"
        tie = "several primitives are hit at exactly this t; ours is the first of them, Mitsuba's is another"
    else:
        agree = "all that is given is within the bounds of the candidate's arithmetic"
        tie = "several primitives are hit at exactly this t, or the ray starts on one: any of them is right"
    who, precision = subject_name(judge), judge.answer.precision
    explained = f"{who} is exactly right, and rounding in float32 allows Mitsuba's answer, too"
    unresolved = f"{who} is exactly right; float32, in which Mitsuba computes, cannot resolve this pixel"
    if not right:
        explained = f"rounding in {precision} allows the candidate's answer, which is not the exact one"
        unresolved = f"{precision}, in which the candidate computes, cannot resolve this pixel"
    return {AGREE: agree, EXPLAINED: explained, TIE: tie, OUT_OF_DOMAIN: unresolved}


def constant_reasons(judge: Judge) -> dict[str, str]:
    """The reason of each class whose reason is the same at every pixel."""
    right = _reasons(judge, right=True)
    return right if judge.answer.exact_visibility else {name: right[name] for name in (AGREE, TIE)}


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
    return _reasons(judge, right=judge.answer.exact_visibility or judgement.is_right(row))[verdict]


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


def not_judged(judge: Judge, judgement: Judgement, row: int) -> dict[str, str]:
    """Quantities of our caster that were not compared, with the reason; their ratio of 0 is no agreement."""
    ours, theirs = bool(judge.hit[row]), bool(judge.pair.reference.hit.ravel()[row])
    found = {}
    if not (ours and theirs):
        why = f"{'ours' if ours else 'Mitsuba'} alone hits" if ours or theirs else "nothing is hit"
        found = dict.fromkeys(COMPARED_AT_HITS, why)
    if not ours:
        found["on_surface"] = "ours hits nothing"
    if not ours or judgement.classes[row] != CLASS_CODE[AGREE]:
        found["diffuse"] = "light is compared where both see the same surface at the same place"
    if judgement.exact.of(row) is None:
        found[EXACT] = "there is no ray" if judge.t_max[row] < 0.0 else "exact arithmetic gave no answer"
    # A quantity that contradicts another is reported as beyond all bounds, although it was not compared.
    return {name: why for name, why in found.items() if not judgement.ratios[name][row] > 0.0}


# ---- answers of a pixel: shape and t, in decimal and to the bit ----

MAX_TIES_SHOWN = 6  # members of an exact tie set on one line; JSON has all
AOVS_SHOWN = ("position", "normal", "shading_normal", "uv", "diffuse")  # shown beside shape and depth if compared


class TieMember(NamedTuple):
    """One primitive of an exact tie set."""

    shape: str
    prim: int  # within its shape
    where: str


def tie_members(scene: Scene, packed: Packed, answer: ExactAnswer) -> list[TieMember]:
    """The exact tie set in the scene's own names."""
    named = zip(named_prims(scene, packed, answer.prims), answer.ties, strict=True)
    return [TieMember(*surface, hit.where) for surface, hit in named]


def format_exact(scene: Scene, packed: Packed, answer: ExactAnswer | None, *, with_t: bool = True) -> str:
    """The exact answer on one line."""
    if answer is None:
        return "no answer"
    if answer.t is None:
        return "miss"
    ties = [f"{each.shape}, prim {each.prim} ({each.where})" for each in tie_members(scene, packed, answer)]
    if len(ties) > MAX_TIES_SHOWN:
        ties[MAX_TIES_SHOWN:] = [f"{len(ties) - MAX_TIES_SHOWN} more"]
    at = f" at t {decimal_and_hex(float(answer.t))}" if with_t else ""
    return f"{' = '.join(ties)}{at}"


def exact_answer(judge: Judge, judgement: Judgement, row: int) -> ExactAnswer | None:
    """The exact answer at a row, computed now if it is not known; None if there is no ray."""
    known = judgement.exact.of(row)
    if known is not None or judge.t_max[row] < 0.0:
        return known
    return judge.oracle.first_hit(judge.o[row], judge.d[row], float(judge.t_min[row]), float(judge.t_max[row]))


def pixel_answers(judge: Judge, judgement: Judgement, row: int, check: str) -> tuple[str, str, str]:
    """The subject's, the reference's and the exact answer at one row of the image.

    check: whose values are shown of a subject that gives images.
    """
    exact = format_exact(judge.scene, judge.model.packed, exact_answer(judge, judgement, row))
    if judge.names_prims:
        sides = judge.pair.subject, judge.pair.reference
        subject, reference = (_aovs_text(judge.scene, aovs, check, row) for aovs in sides)
        return subject, reference, exact
    answer, result, shape = judge.answer, judge.result, int(judge.result.shape_id[row])
    parts = [f"t {decimal_and_hex(float(answer.t[row]))}" if answer.hit[row] else "miss"]
    if answer.n is not None and answer.hit[row]:
        parts.append(f"n ({format_numbers(answer.n[row])})")
    parts += [why for why, rows in answer.broken.items() if rows[row]]
    ray = f"along o ({format_numbers(judge.o[row])}), d ({format_numbers(judge.d[row])})"
    reference = "miss"
    if shape >= 0:
        n = format_numbers(aov_rows(judge.pair.reference, "normal")[row])
        reference = f"{judge.scene.shape_names()[shape]} at t {decimal_and_hex(float(result.t[row]))}, n ({n})"
    rows = np.array([row])
    prim, t = judgement.exact.first_hits(rows)
    if prim[0] >= 0 and judge.n is not None:  # in float64 at the surface that is hit: normals have no exact value
        exact += f", n ({format_numbers(judge.near(rows, prim, t).n[0])})"
    return ", ".join([*parts, ray]), reference, exact


def _aovs_text(scene: Scene, aovs: Any, check: str, row: int) -> str:
    """Shape, depth, and the value that was compared."""
    shape = int(aov_rows(aovs, "shape_id")[row])
    name = scene.shape_names()[shape] if shape >= 0 else "miss"
    text = f"{name} at depth {float(aov_rows(aovs, 'depth')[row])!r}"
    if check in AOVS_SHOWN:
        values = aov_rows(aovs, check)[row]
        value = ", ".join(f"{v:.9g}" if check != "position" else repr(float(v)) for v in values)
        text += f", {check} ({value})"
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

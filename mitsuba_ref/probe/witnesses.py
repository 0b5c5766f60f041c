"""The witnesses of a ray: ours, a candidate, exact arithmetic, and Mitsuba in each of its variants and modes."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from mitsuba_ref.error_model.bounds import intersections_at, row_distance
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.error_model.scene_model import OUR_SIDE, REFERENCE_SIDE
from mitsuba_ref.judge.adjudication import named_prims, ratio_to_bound
from mitsuba_ref.judge.classification import EXACT, Judge
from mitsuba_ref.judge.comparison import reference_prims
from mitsuba_ref.oracle.oracle import ExactAnswer
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.rendering import ReferenceResult, trace_reference
from mitsuba_ref.subjects.subject import FLOAT32, FLOAT64

CANDIDATE = "candidate"
WIDEST_NAME = 27  # characters, of Mitsuba's LLVM variant with its default mode
MISSING = "does not work here"
MODES = {"robust": True, "default": False}  # of Embree, by the scene's embree_use_robust_intersections


@dataclass(frozen=True)
class WitnessAnswer:
    """One witness's answer for the ray, compared with exact arithmetic."""

    who: str  # ours, exact, a candidate, or a variant of Mitsuba with its mode
    shape: str = ""  # "miss" on a miss
    prim: int = -1  # within its shape, -1 on a miss
    t: float = math.nan
    right: bool | None = None  # names a surface that is hit exactly, with t within its bound; None: undecided
    off: float | None = None  # t minus the exact t; None on a miss, or if another surface is hit
    ulps: float | None = None  # `off` in units of the last place of `format`; None also if that overflows
    format: str = ""  # float32 or float64, in which it computes
    share: float | None = None  # |off| over its bound in `format`
    problem: str = ""  # why there is no answer
    normal_share: float | None = None  # error of the normal over its bound, if that is judged
    remark: str = ""  # defects of the answer itself


def witness_answers(judge: Judge, answer: ExactAnswer | None) -> tuple[WitnessAnswer, ...]:
    """The answers of all witnesses. judge: of a window of one pixel."""
    surface, t = surface_of(judge, int(judge.subject_prim[0])), float(judge.answer.t[0])
    rows = [compared_with_exact(WitnessAnswer("ours", *surface, t, format=FLOAT64), judge, answer)]
    if answer is not None:
        rows.append(WitnessAnswer(EXACT, *surface_of(judge, answer.prim), answer.distance, right=True))
    return (*rows, *_of_mitsuba(judge, answer))


def _of_mitsuba(judge: Judge, exact: ExactAnswer | None) -> Iterator[WitnessAnswer]:
    """Of each variant in each mode, the judge's own among them."""
    result, given = judge.result, judge.result.answer.versions["variant"]
    works = {*variants.usable_variants().names, given}
    for variant, (mode, robust) in product(dict.fromkeys((*variants.VARIANT_NAMES, given)), MODES.items()):
        who = f"mitsuba {variant} {mode}"
        if variant not in works:
            yield WitnessAnswer(who, problem=MISSING)
            continue
        found: ReferenceResult | Crash = result
        if (variant, robust) != (given, result.robust):
            found = trace_reference(judge.scene, judge.model, judge.rays, variant=variant, lights=False, robust=robust)
        if isinstance(found, Crash):
            yield WitnessAnswer(who, problem=f"no answer ({found.exit}): {found.headline}")
            continue
        surface = surface_of(judge, int(reference_prims(found, judge.model)[0]))
        yield compared_with_exact(WitnessAnswer(who, *surface, float(found.t[0]), format=FLOAT32), judge, exact)


def surface_of(judge: Judge, prim: int) -> tuple[str, int]:
    """(shape, number within the shape) of a primitive of the scene."""
    if prim < 0:
        return "miss", -1
    return named_prims(judge.scene, judge.model.packed, np.array([prim]))[0]


def compared_with_exact(witness: WitnessAnswer, judge: Judge, exact: ExactAnswer | None) -> WitnessAnswer:
    """An answer of ours (float64) or Mitsuba (float32) compared with the exact one."""
    if exact is None:
        return witness
    surfaces = {surface_of(judge, int(prim)) for prim in exact.prims} or {("miss", -1)}
    if (witness.shape, witness.prim) not in surfaces:
        return replace(witness, right=False)
    side = OUR_SIDE if witness.format == FLOAT64 else REFERENCE_SIDE
    at = intersections_at(judge.model, np.array([exact.prim]), judge.o, judge.d, np.array([witness.t]), side)
    found = with_error_of_t(witness, exact, at.t_error)
    return replace(found, right=found.share is None or found.share <= 1.0)


def as_witness(judge: Judge, row: int) -> WitnessAnswer:
    """The candidate's row among the witnesses: errors of t and of the normal, from the exact hit that fits best."""
    answer = judge.answer.rows(np.array([row]))
    what, t = "a hit" if answer.hit[0] else "miss", float(answer.t[0])  # it names no shape
    claimed = WitnessAnswer(CANDIDATE, what, -1, t, format=answer.precision, remark=", ".join(answer.broken))
    if judge.t_max[row] < 0.0:
        return claimed
    adjudicated = judge.adjudicated(np.array([row]))
    (exact,) = adjudicated.answers
    if exact is None:
        return claimed
    prims = exact.prims
    at = judge.near(np.full(len(prims), row), prims, np.full(len(prims), np.nan if exact.t is None else float(exact.t)))
    found = with_error_of_t(claimed, exact, at.t_error + answer.t_rounding)
    if found.share is not None and answer.n is not None and not found.remark:
        shares = ratio_to_bound(row_distance(answer.n.repeat(len(prims), axis=0), at.n), at.n_error)
        found = replace(found, normal_share=float(shares.min()))
    return replace(found, right=bool(adjudicated.right[0] and not found.remark))


def with_error_of_t(witness: WitnessAnswer, exact: ExactAnswer, bounds: Array) -> WitnessAnswer:
    """The witness with the error of its t, as a share of the loosest bound; unchanged where either misses."""
    if exact.t is None or not np.isfinite(witness.t):
        return witness
    off = exact.t.off(witness.t) * -exact.t.compare(witness.t)
    share = float(ratio_to_bound(np.abs(off), bounds).min())
    with np.errstate(over="ignore", under="ignore"):
        ulp = float(np.spacing(np.abs(np.asarray(exact.distance).astype(witness.format))))
    return replace(witness, off=off, ulps=off / ulp if np.isfinite(ulp) else None, share=share)


def witness_lines(found: tuple[WitnessAnswer, ...]) -> Iterator[str]:
    """A table for a terminal, without the exact answer; empty for a pixel without a ray."""
    shown = [each for each in found if each.who != EXACT]
    surfaces = [f"{each.shape}, prim {each.prim}" if each.prim >= 0 else each.shape for each in shown]
    width = max(map(len, surfaces), default=0)
    for each, surface in zip(shown, surfaces, strict=True):
        verdict = {True: "right", False: "WRONG", None: "?"}[each.right]
        answer = f"{verdict:<7}  {surface:<{width}}  {_error_text(each)}"
        yield f"  {each.who:<{WIDEST_NAME}}  {each.problem or answer}".rstrip()
    if any(each.problem == MISSING for each in found):
        yield f"  {MISSING}: {variants.usable_variants().why}"


def _error_text(witness: WitnessAnswer) -> str:
    """The error of t in ulps, errors beyond their bounds as multiples of these, and a remark if there is one."""
    parts = []
    if witness.ulps is not None:
        parts.append(f"{witness.ulps:+.3g} ulps of {witness.format}" if witness.ulps else f"exact in {witness.format}")
    of_t = witness.share if witness.right is False else None  # an answer may be right although t leaves its bound
    for prefix, share in (("", of_t), ("normal ", witness.normal_share)):
        if share is not None and not share <= 1.0:
            parts.append(f"{prefix}{share:.3g}x its bound")
    return ", ".join((*parts, *filter(None, [witness.remark])))

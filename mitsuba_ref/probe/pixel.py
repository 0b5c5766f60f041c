"""One pixel: the answer of every witness, bounds, every primitive that may be hit; as text for a terminal.

The witnesses are ours, a candidate, exact arithmetic, and Mitsuba in each of its variants and modes.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields, is_dataclass, replace
from itertools import chain
from typing import Any

import numpy as np

from caster.aovs import Aovs
from caster.description.errors import SceneError
from caster.rendering.bounces import RAY_KINDS
from caster.scene.model import Scene
from caster.system.terminal import folded
from mitsuba_ref.error_model.bounds import aov_rows, intersections_at, row_distance
from mitsuba_ref.error_model.bracket import latest_hits
from mitsuba_ref.error_model.tolerances import DISTINCT_RTOL, KU, KU_OURS
from mitsuba_ref.judge.adjudication import named_prims, ratio_to_bound
from mitsuba_ref.judge.classification import EXACT, Judge, Judgement, judge_of, reference_prims
from mitsuba_ref.judge.diagnosis import diagnose
from mitsuba_ref.judge.explanations import (
    MAX_TIES_SHOWN,
    decimal_and_hex,
    exact_answer,
    exceeded_bounds,
    full_reason,
    not_judged,
    pixel_answers,
    tie_members,
)
from mitsuba_ref.judge.pipeline import Task, further_rays
from mitsuba_ref.judge.verdict import AGREE, CLASSES, FAILING, UNDECIDED, UNLISTED, WRONG, json_number
from mitsuba_ref.oracle.oracle import ExactAnswer
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT, SendRequest, send_stored
from mitsuba_ref.reference.rendering import ReferenceResult, trace_reference
from mitsuba_ref.reference.shared_input import SharedRays, shared_rays
from mitsuba_ref.shapes import reference_of
from mitsuba_ref.subjects.bounce_films import bounce_films
from mitsuba_ref.subjects.requests import request_answer
from mitsuba_ref.subjects.subject import COMPARED_AOVS, OURS, NoAnswer, Subject

# ---- witnesses

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
    ulps: float | None = None  # `off` in units of the last place of `format`
    format: str = ""  # float32 or float64, in which it computes
    share: float | None = None  # |off| over its bound in `format`
    problem: str = ""  # why there is no answer
    normal_share: float | None = None  # error of the normal over its bound, if that is judged
    remark: str = ""  # defects of the answer itself


def witness_answers(judge: Judge, answer: ExactAnswer | None) -> tuple[WitnessAnswer, ...]:
    """The answers of all witnesses. judge: of a window of one pixel."""
    ours = ("ours", *surface_of(judge, int(judge.pair.prim[0])), float(judge.pair.t[0]))
    rows = [compared_with_exact(ours, judge, answer, np.float64)]
    if answer is not None:
        t = np.inf if answer.t is None else float(answer.t)
        rows.append(WitnessAnswer(EXACT, *surface_of(judge, answer.prim), t, right=True))
    rows += [_of_mitsuba(f"mitsuba {variant}", found, judge, answer) for variant, found in mitsuba_answers(judge)]
    return tuple(rows)


def mitsuba_answers(judge: Judge) -> list[tuple[str, ReferenceResult | Crash | str]]:
    """Answers by variant with its mode, the judge's own among them; each variant runs in its own process."""
    result, given = judge.result, judge.result.answer.versions["variant"]
    works = {*variants.usable_variants().names, given}

    def ask(variant: str) -> list[tuple[str, ReferenceResult | Crash | str]]:
        answers: dict[str, ReferenceResult | Crash | str] = {}
        for mode, robust in MODES.items():
            if (variant, robust) == (given, result.robust):
                answers[mode] = result
            elif variant in works:
                rays = judge.pair.rays
                answers[mode] = trace_reference(
                    judge.scene, judge.model, rays, variant=variant, lights=False, robust=robust
                )
            else:
                answers[mode] = MISSING
        return [(f"{variant} {mode}", answer) for mode, answer in answers.items()]

    with ThreadPoolExecutor() as pool:
        return list(chain.from_iterable(pool.map(ask, dict.fromkeys((*variants.VARIANT_NAMES, given)))))


def surface_of(judge: Judge, prim: int) -> tuple[str, int]:
    """(shape, number within the shape) of a primitive of the scene."""
    if prim < 0:
        return "miss", -1
    return named_prims(judge.scene, judge.model.packed, np.array([prim]))[0]


def _of_mitsuba(
    who: str, found: ReferenceResult | Crash | str, judge: Judge, exact: ExactAnswer | None
) -> WitnessAnswer:
    if not isinstance(found, ReferenceResult):
        problem = found if isinstance(found, str) else f"no answer ({found.exit}): {found.headline}"
        return WitnessAnswer(who, problem=problem)
    surface = surface_of(judge, int(reference_prims(found, judge.model)[0]))
    return compared_with_exact((who, *surface, float(found.t[0])), judge, exact, np.float32)


def compared_with_exact(
    claimed: tuple[str, str, int, float], judge: Judge, exact: ExactAnswer | None, kind: type
) -> WitnessAnswer:
    """An answer compared with the exact one. kind: the type that it was computed in."""
    witness = WitnessAnswer(*claimed, format=np.dtype(kind).name)
    if exact is None:
        return witness
    surfaces = {surface_of(judge, int(prim)) for prim in exact.prims} or {("miss", -1)}
    if claimed[1:3] not in surfaces:
        return replace(witness, right=False)
    ours, prim, t = kind is np.float64, np.array([exact.prim]), np.array([claimed[3]])
    at = intersections_at(judge.model, prim, (judge.o, judge.d), t, KU_OURS if ours else KU, ours=ours)
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


def with_error_of_t(witness: WitnessAnswer, exact: ExactAnswer, bounds: np.ndarray) -> WitnessAnswer:
    """The witness with the error of its t, as a share of the loosest bound; unchanged where either misses."""
    if exact.t is None or not np.isfinite(witness.t):
        return witness
    off = exact.t.off(witness.t) * -exact.t.compare(witness.t)
    share = float(ratio_to_bound(np.abs(off), bounds).min())
    return replace(witness, off=off, ulps=in_ulps(off, exact, np.dtype(witness.format)), share=share)


def in_ulps(off: float, exact: ExactAnswer, format: np.dtype[Any]) -> float | None:
    """`off` in units of the last place of the exact t in a format; None if that overflows."""
    assert exact.t is not None
    with np.errstate(over="ignore", under="ignore"):
        ulp = float(np.spacing(np.abs(np.asarray(float(exact.t)).astype(format))))
    return off / ulp if np.isfinite(ulp) else None


def witness_lines(found: tuple[WitnessAnswer, ...]) -> Iterator[str]:
    """A table for a terminal, without the exact answer; empty for a pixel without a ray."""
    shown = [each for each in found if each.who != EXACT]
    surface = max((len(_surface_text(each)) for each in shown), default=0)
    for each in shown:
        verdict = {True: "right", False: "WRONG", None: "?"}[each.right]
        verdict = "allowed" if _is_loose(each) else verdict
        answer = f"{verdict:<7}  {_surface_text(each):<{surface}}  {_error_text(each)}"
        yield f"  {each.who:<{WIDEST_NAME}}  {each.problem or answer}".rstrip()
    if any(each.problem == MISSING for each in found):
        yield f"  {MISSING}: {variants.usable_variants().why}"


def t_lines(found: tuple[WitnessAnswer, ...]) -> Iterator[str]:
    """t of each that hits, in decimal and to the bit."""
    yield from (f"  {each.who:<{WIDEST_NAME}}  {decimal_and_hex(each.t)}" for each in found if np.isfinite(each.t))


def _surface_text(each: WitnessAnswer) -> str:
    return f"{each.shape}, prim {each.prim}" if each.prim >= 0 else each.shape


def _error_text(each: WitnessAnswer) -> str:
    """The errors of an answer as text, with those beyond their bounds."""
    parts = []
    if each.ulps is not None:
        parts.append(f"{each.ulps:+.3g} ulps of {each.format}" if each.ulps else f"exact in {each.format}")
    if _is_loose(each) and each.off:
        parts.append(f"allowed: t is off by {100.0 * abs(each.off / each.t):.2g} %")
    for what, share in (("", each.share if each.right is False else None), ("normal ", each.normal_share)):
        if share is not None and not share <= 1.0:
            parts.append(f"{what}{share:.3g}x its bound")
    return ", ".join((*parts, *filter(None, [each.remark])))


def _is_loose(each: WitnessAnswer) -> bool:
    """Whether t is right only because its bound is loose."""
    return bool(each.right and each.off and abs(each.off) > DISTINCT_RTOL * abs(each.t))


# ---- verdicts


@dataclass(frozen=True, kw_only=True)
class Explained:
    """The class of one ray, and why."""

    verdict: str
    why: str = ""
    case: str = ""  # where the reference is wrong: the number of the known case, or "unlisted"
    problem: str = ""  # why there is nothing to judge

    @property
    def ok(self) -> bool:
        return not self.problem and self.verdict not in FAILING and self.case != UNLISTED


@dataclass(frozen=True, kw_only=True)
class CandidatePixel(Explained):
    """The verdict on one pixel of a candidate."""

    name: str
    precision: str = ""  # by whose bounds it is judged
    says: Mapping[str, Any] = field(default_factory=dict)  # hit, t, depth, normal, if given
    notes: tuple[str, ...] = ()
    witness: WitnessAnswer | None = None  # its row among the witnesses


@dataclass(frozen=True, kw_only=True)
class PathRay(Explained):
    """One secondary ray and its verdict."""

    path: str  # a letter for each bounce, such as RTS
    answers: tuple[str, ...] = ()  # as text: the subject's, the reference's, the exact one


@dataclass(frozen=True)
class PossibleHit:
    """A primitive that the ray may hit in float32, and where."""

    shape: str
    prim: int  # within its shape
    t: float
    t_error: float
    certain: bool


@dataclass(frozen=True, kw_only=True)
class PixelVerdict(Explained):
    """The verdict on one pixel, and its reasons."""

    x: int
    y: int
    ray: dict[str, Any]
    ours: dict[str, Any] = field(default_factory=dict)
    reference: dict[str, Any] = field(default_factory=dict)
    exact: dict[str, Any] = field(default_factory=dict)
    ratios: dict[str, float] = field(default_factory=dict)  # error over bound, of what was judged
    not_judged: dict[str, str] = field(default_factory=dict)  # the rest, and why
    possible: tuple[PossibleHit, ...] = ()
    versions: dict[str, str] = field(default_factory=dict)
    witnesses: tuple[WitnessAnswer, ...] = ()  # a candidate, ours, exact, Mitsuba in each of its variants and modes
    candidate: CandidatePixel | None = None  # if one was requested
    path: tuple[PathRay, ...] | None = None  # its secondary rays, if they were requested

    def __str__(self) -> str:
        """The text of `mitsuba-ref probe`."""
        return as_text(self, "the scene")

    @property
    def ok(self) -> bool:
        """Whether our answer, Mitsuba's and the candidate's, if there is one, are explained."""
        return super().ok and all(each.ok for each in (self.candidate, *(self.path or ())) if each is not None)

    def to_dict(self) -> dict[str, Any]:
        """For JSON; infinite numbers become text."""
        plain: dict[str, Any] = _json_value(self)
        return plain


ProbeEvidence = tuple[Judge, Judgement]  # of an image of this one pixel


# Stand-ins are cut to the rays of the whole film, or for larger films to those of a smaller one with the same view, so
# that one pixel does not cost as much as the film.
STAND_IN_PIXELS = 1 << 20


def stand_in_rays(scene: Scene) -> SharedRays | None:
    """The rays that stand-ins of a scene are cut to; None where it has none."""
    if not any(reference_of(shape).stand_in_note for shape in scene.shapes):
        return None
    width, height = scene.film.width, scene.film.height
    shrink = min(1.0, (STAND_IN_PIXELS / (width * height)) ** 0.5)
    width, height = (max(1, int(side * shrink)) for side in (width, height))
    return shared_rays(scene.with_film(width=width, height=height, crop=(0, 0, width, height)))


def probe_with_evidence(
    scene: Scene, x: int, y: int, candidate: Subject | None = None, timeout: float = DEFAULT_TIMEOUT, bounces: int = 0
) -> tuple[PixelVerdict, ProbeEvidence | Crash]:
    """Judge one pixel, also for a candidate if there is one, and return the evidence as well.

    timeout: seconds for Mitsuba's answer. bounces: also judge its secondary rays, to this depth.
    Raises SceneError for a pixel outside the film.
    """
    film = scene.film
    if not (0 <= x < film.width and 0 <= y < film.height):
        inside = f"0 <= x < {film.width} and 0 <= y < {film.height}"
        raise SceneError(f"pixel ({x}, {y}): outside the film, expected {inside}")
    whole = stand_in_rays(scene)
    asked_for, scene = scene, scene.with_film(crop=(x, y, x + 1, y + 1))
    judge = judge_of(request_answer(OURS, scene, whole=whole), timeout=timeout)
    if isinstance(judge, Crash):
        crash = PixelVerdict(x=x, y=y, verdict=UNDECIDED, ray=_ray(shared_rays(scene)), problem=judge.message)
        return crash, judge
    pair, judgement = judge.pair, judge.judge()
    exact = exact_answer(judge, judgement, 0)
    theirs = None if candidate is None else probe_candidate(candidate, asked_for, (x, y), timeout)
    witnesses = witness_answers(judge, exact) if judge.t_max[0] >= 0.0 else ()
    left = not_judged(judge, judgement, 0)
    found = PixelVerdict(
        **_class_of(judge, judgement, diagnose(judge, judgement).by_row()),
        x=x,
        y=y,
        ray=_ray(pair.rays),
        ours=_answer(scene, pair.subject, pair.t),
        reference=_answer(scene, pair.reference, pair.result.t),
        exact=_exact(judge, exact),
        ratios={name: float(judgement.ratios[name][0]) for name in judgement.ratios if name not in left},
        not_judged=left,
        possible=tuple(_possible(scene, judge)),
        versions=pair.result.answer.versions,
        witnesses=witnesses if theirs is None or theirs.witness is None else (theirs.witness, *witnesses),
        candidate=theirs,
        path=tuple(follow_path(scene, bounces, candidate or OURS, timeout)) if bounces else None,
    )
    return found, (judge, judgement)


def _class_of(judge: Judge, judgement: Judgement, diagnosed: Mapping[int, str], row: int = 0) -> dict[str, str]:
    """The fields of `Explained` for a row of the image."""
    case = {row: UNLISTED if number is None else str(number) for row, number in judgement.cases.items()}.get(row, "")
    why = full_reason(judge, judgement, diagnosed, row)
    return {"verdict": CLASSES[int(judgement.classes[row])], "why": why, "case": case}


# ---- a candidate, in the words of `validate`: it answers the whole image, all of which is judged


def probe_candidate(
    candidate: Subject,
    scene: Scene,
    pixel: tuple[int, int],
    timeout: float = DEFAULT_TIMEOUT,
    send: SendRequest = send_stored,
) -> CandidatePixel:
    """Request the answer and judge it. timeout, send: as for `validate`. Raises SceneError."""
    window = window_of(candidate, scene, *pixel)
    try:
        response = request_answer(candidate, window)
    except NoAnswer as error:
        witness = WitnessAnswer(CANDIDATE, problem="no answer")
        return CandidatePixel(name=candidate.name, verdict=UNDECIDED, problem=str(error), witness=witness)
    judge = judge_of(response, timeout=timeout, send=send, with_files=False)
    if isinstance(judge, Crash):
        return CandidatePixel(name=candidate.name, verdict=UNDECIDED, problem=judge.message)
    x0, y0, x1, _ = window.film.window
    row = (pixel[1] - y0) * (x1 - x0) + pixel[0] - x0
    judgement, witness = judge.judge(), as_witness(judge, row)
    shares = {"mask": float(judgement.ratios["mask"][row]), "t": witness.share, "normal": witness.normal_share}
    exceeded = {name: share for name, share in shares.items() if share is not None and not witness.remark}
    diagnosis = diagnose(judge, judgement, further_rays(candidate, response.scene))
    found = _class_of(judge, judgement, diagnosis.by_row(), row)
    why = filter(None, (found["why"], exceeded_bounds(exceeded)))
    found["why"] = "\n".join(["; ".join(why), *diagnosis.evidence_at(row)])
    if row in judgement.not_adjudicated and witness.right is False:  # but here it is adjudicated
        found["verdict"] = WRONG
    return CandidatePixel(
        **found,
        name=candidate.name,
        precision=judge.answer.precision,
        says=_answer_record(judge, row),
        notes=(*judge.answer.notes, *response.limits),
        witness=witness,
    )


def window_of(candidate: Subject, scene: Scene, x: int, y: int) -> Scene:
    """The scene with the window that `validate` judges this pixel in; with the whole film where the crop is without."""
    whole = scene.with_film(crop=(0, 0, scene.film.width, scene.film.height))
    windows = (window for film in (scene, whole) for window in Task(film, "", subject=candidate).windows())
    for window in windows:
        x0, y0, x1, y1 = window.film.window
        if x0 <= x < x1 and y0 <= y < y1:
            break
    return window


def _answer_record(judge: Judge, row: int) -> dict[str, Any]:
    """The answer for JSON; the normal has length 1, or is NaN where it was not finite."""
    aovs, hit, t = judge.pair.subject, bool(judge.answer.hit[row]), float(judge.answer.t[row])
    names = [name for name in ("depth", "normal") if name in aovs and (hit or name == "depth")]
    return {"hit": hit, "t": t} | {name: aov_rows(aovs, name)[row].tolist() for name in names}


# ---- secondary rays

LETTERS = dict(zip(RAY_KINDS, ("", "R", "T", "S"), strict=True))
LEGEND = "\nsecondary rays by their paths: R reflected, T refracted, S to a light"


def follow_path(scene: Scene, depth: int, subject: Subject, timeout: float) -> Iterator[PathRay]:
    """All rays that come from the pixels of a film, which has one, bounce after bounce. Raises NoAnswer."""
    paths = [""]
    for film in bounce_films(scene, depth):
        rays = film.bounce.rays
        paths = [paths[parent] + LETTERS[RAY_KINDS[kind]] for parent, kind in zip(rays.parent, rays.kind, strict=True)]
        judge = judge_of(request_answer(subject, film.scene, rays=film.rays), timeout=timeout)
        if isinstance(judge, Crash):
            yield PathRay(path=paths[0], verdict=UNDECIDED, problem=judge.message)
            return
        judgement = judge.judge()
        diagnosed = diagnose(judge, judgement).by_row()
        for path, row in zip(paths, film.row.tolist(), strict=True):
            answers = pixel_answers(judge, judgement, row, EXACT)
            yield PathRay(**_class_of(judge, judgement, diagnosed, row), path=path, answers=answers)


def path_lines(rays: Sequence[PathRay]) -> Iterator[str]:
    """A line for each ray; where the answers do not agree, all of them."""
    yield LEGEND if rays else "\nno secondary rays"
    width = max((len(each.path) for each in rays), default=0)
    for each in rays:
        answer, *others = *each.answers, each.problem or each.why
        yield f"  {each.path:<{width}}  {each.verdict.replace('_', ' ')}: {answer}"
        if each.verdict != AGREE:
            names = ("Mitsuba:", "exact:", "why:")
            yield from (f"  {'':<{width}}    {name:<8} {words}" for name, words in zip(names, others, strict=False))


# ---- for JSON


def _ray(rays: SharedRays) -> dict[str, Any]:
    return {name: _numbers(getattr(rays, name)[0]) for name in ("o", "d", "t_max", "start")}


def _exact(judge: Judge, answer: ExactAnswer | None) -> dict[str, Any]:
    """The exact answer for JSON; empty if there is no ray or no answer."""
    if answer is None:
        return {}
    ties = [each._asdict() for each in tie_members(judge.scene, judge.model.packed, answer)]
    t = np.inf if answer.t is None else float(answer.t)
    return {"hit": answer.hit, "t": t, "ties": ties, "flags": sorted(answer.flags)}


def _answer(scene: Scene, aovs: Aovs, t: np.ndarray) -> dict[str, Any]:
    shape = int(aov_rows(aovs, "shape_id")[0])
    values = {name: _numbers(aov_rows(aovs, name)[0]) for name in COMPARED_AOVS if name != "shape_id" and name in aovs}
    return {"shape": scene.shape_names()[shape] if shape >= 0 else "miss", "t": _numbers(t[0]), **values}


def _possible(scene: Scene, judge: Judge) -> Iterator[PossibleHit]:
    """All primitives that the reference may hit, nearest first."""
    rays, bracket = judge.pair.rays, judge.reference_bracket
    t_max = rays.t_max.astype(np.float64)
    found = bracket.possible_hits(rays.o.astype(np.float64), rays.d.astype(np.float64), t_max)
    certain = np.isfinite(latest_hits(found, t_max))
    surfaces = named_prims(scene, judge.model.packed, found.prim)
    for i in np.argsort(found.at.t, kind="stable"):
        shape, prim = surfaces[i]
        yield PossibleHit(shape, prim, float(found.at.t[i]), float(found.at.t_error[i]), bool(certain[i]))


def _numbers(values: Any) -> Any:
    return np.asarray(values, np.float64).tolist()


def _json_value(value: Any) -> Any:
    if is_dataclass(value):
        found = {each.name: getattr(value, each.name) for each in fields(value)}
        value = found | {"ok": value.ok} if isinstance(value, Explained) else found
    if isinstance(value, Mapping):
        return {key: _json_value(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_json_value(each) for each in value]
    return json_number(value) if isinstance(value, float) else value


# ---- for a terminal

MAX_PRIMS_SHOWN = 12  # primitives; --json has all


def as_text(found: PixelVerdict, path: str, *, brief: bool = False) -> str:
    """The verdict as text for a terminal. brief: without the numbers behind it."""
    return folded("\n".join(_lines(found, path, brief)))


def _lines(found: PixelVerdict, path: str, brief: bool) -> Iterator[str]:
    yield from _head(found, path)
    if found.problem:
        yield found.problem
        return
    yield "\nwho is right"
    yield from _exact_lines(found.exact)
    yield from witness_lines(found.witnesses)
    yield from (f"  note: {note}" for note in (found.candidate.notes if found.candidate else ()))
    if found.path is not None:
        yield from path_lines(found.path)
    if brief:
        return
    yield "\nthe ray"
    for name, value in found.ray.items():
        yield from _value_lines(name, value)
    yield "\nt, in lengths of d"
    yield from t_lines(found.witnesses)
    for name in [name for name in found.ours if name not in ("shape", "t")]:
        yield f"\n{name}"
        for who, value in _sides(found, name).items():
            yield from _value_lines(who, value)
    yield "\nshare of each bound that our error uses"
    for name, ratio in found.ratios.items():
        yield f"  {name:<16}{ratio:.3g}" if math.isfinite(ratio) else f"  {name:<16}no bound allows this"
    for name, why in found.not_judged.items():
        yield f"  {name:<16}not judged: {why}"
    yield "\nprimitives that may be hit in float32, t and how far it may be off"
    for each in found.possible[:MAX_PRIMS_SHOWN]:
        mark = "certain" if each.certain else ""
        yield f"  {each.t!r:<22} +- {each.t_error:<10.3g} {each.shape}, prim {each.prim} {mark}".rstrip()
    if len(found.possible) > MAX_PRIMS_SHOWN:
        yield f"  and {len(found.possible) - MAX_PRIMS_SHOWN} more (--json lists them)"
    yield f"\nreference: {', '.join(f'{name} {version}' for name, version in found.versions.items())}"


def _head(found: PixelVerdict, path: str) -> Iterator[str]:
    """Classes with their reasons, the candidate's first if there is one."""
    place, theirs = f"pixel ({found.x}, {found.y}) of {path}", found.candidate
    yield f"{place}: {(theirs or found).verdict}"
    if theirs is None:
        if not found.problem:
            yield f"why:       {found.why}"
        return
    held = f", held to the bounds of {theirs.precision}" if theirs.precision else ""
    yield f"candidate: {theirs.name}{held}"
    first, *rest = (theirs.problem or theirs.why).splitlines() or [""]
    yield f"why:       {first}"
    yield from (f"           {line}" for line in rest)
    yield f"ours:      {found.verdict}: {found.why}"


def _sides(found: PixelVerdict, name: str) -> dict[str, Any]:
    """One quantity by each side."""
    theirs = found.candidate.says if found.candidate is not None else {}
    sides = {"ours": found.ours[name], "reference": found.reference[name]}
    return sides | ({"candidate": theirs[name]} if name in theirs else {})


def _exact_lines(exact: dict[str, Any]) -> Iterator[str]:
    """What is hit exactly, and the other intersections of the ray."""
    if not exact:
        yield "  exact: no answer"
        return
    yield f"  exact: t {exact['t']!r}  {exact['t'].hex()}" if exact["hit"] else "  exact: miss"
    for tie in exact["ties"][:MAX_TIES_SHOWN]:
        yield f"         {tie['shape']}, prim {tie['prim']} ({tie['where']})"
    if len(exact["ties"]) > MAX_TIES_SHOWN:
        yield f"         and {len(exact['ties']) - MAX_TIES_SHOWN} more at the same t (--json lists them)"
    if exact["flags"]:
        yield f"         on the way: {', '.join(exact['flags'])}"


def _value_lines(name: str, value: Any) -> Iterator[str]:
    """Decimal, and hex to the bit, which has a line of its own unless there is just one number."""
    values = value if isinstance(value, list) else [value]
    decimals, bits = " ".join(map(repr, values)), " ".join(float(each).hex() for each in values)
    gap = "  " if len(values) == 1 else "\n    "
    yield f"  {name:<11}{decimals}{gap}{bits}"

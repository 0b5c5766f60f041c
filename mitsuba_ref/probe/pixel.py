"""One pixel, judged: the answer of every witness, bounds, and its secondary rays."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from caster.aovs import Aovs
from caster.rendering.bounces import RAY_KINDS
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.judge.checks.ray_conventions import further_rays
from mitsuba_ref.judge.classification import EXACT, Judge, Judgement, judge_of
from mitsuba_ref.judge.diagnosis import diagnose, sentence_by_row
from mitsuba_ref.judge.explanations import (
    exact_answer,
    exceeded_bounds,
    format_exact,
    full_reason,
    pixel_answers,
    tie_members,
)
from mitsuba_ref.judge.pipeline import Task
from mitsuba_ref.judge.verdict import AGREE, CLASSES, UNDECIDED, UNLISTED, WRONG
from mitsuba_ref.oracle.oracle import ExactAnswer
from mitsuba_ref.probe.verdict import CandidatePixel, Json, PathRay, PixelVerdict
from mitsuba_ref.probe.witnesses import CANDIDATE, WitnessAnswer, as_witness, witness_answers
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT, SendRequest, send_stored
from mitsuba_ref.reference.shared_input import SharedRays, shared_rays
from mitsuba_ref.shapes import reference_of
from mitsuba_ref.subjects.bounce_films import bounce_films
from mitsuba_ref.subjects.requests import request_answer
from mitsuba_ref.subjects.subject import COMPARED_AOVS, OURS, NoAnswer, Subject

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
    asked_for, scene = scene, scene.with_pixel(x, y)
    judge = judge_of(request_answer(OURS, scene, whole=stand_in_rays(asked_for)), timeout=timeout)
    if isinstance(judge, Crash):
        crash = PixelVerdict(x=x, y=y, verdict=UNDECIDED, ray=_ray(shared_rays(scene)), problem=judge.message)
        return crash, judge
    judgement = judge.judge()
    exact = exact_answer(judge, judgement, 0)
    theirs = None if candidate is None else probe_candidate(candidate, asked_for, (x, y), timeout)
    witnesses = witness_answers(judge, exact) if judge.t_max[0] >= 0.0 else ()
    agrees = judge.hit[0] and judgement.is_class(AGREE)[0]  # elsewhere a share of 0 may mean that nothing was compared
    found = PixelVerdict(
        **_class_of(judge, judgement, sentence_by_row(diagnose(judge, judgement))),
        x=x,
        y=y,
        ray=_ray(judge.rays),
        ours=_answer(scene, judge.subject, judge.answer.t),
        reference=_answer(scene, judge.reference, judge.result.t),
        exact=_exact(judge, exact),
        ratios={name: float(share) for name, (share,) in judgement.ratios.items() if share != 0.0 or agrees},
        versions=judge.result.answer.versions,
        witnesses=witnesses if theirs is None or theirs.witness is None else (theirs.witness, *witnesses),
        candidate=theirs,
        path=tuple(follow_path(scene, bounces, candidate or OURS, timeout)) if bounces else None,
    )
    return found, (judge, judgement)


def _class_of(judge: Judge, judgement: Judgement, diagnosed: Mapping[int, str], row: int = 0) -> dict[str, str]:
    """The fields of `Explained` for a row of the image."""
    case = str(judgement.cases[row] or UNLISTED) if row in judgement.cases else ""
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
    found = _class_of(judge, judgement, sentence_by_row(diagnosis), row)
    why = filter(None, (found["why"], exceeded_bounds(exceeded)))
    causes = [cause for cause in diagnosis if row in cause.rows or row in cause.alike]
    evidence = filter(None, [text for cause in causes for text in (cause.where, cause.remedy)])
    found["why"] = "\n".join(["; ".join(why), *evidence])
    if row in judgement.not_adjudicated and witness.right is False:  # but here it is adjudicated
        found["verdict"] = WRONG
    return CandidatePixel(
        **found,
        name=candidate.name,
        precision=judge.answer.precision,
        says=_answer(judge.scene, judge.subject, judge.answer.t, row),
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


# ---- secondary rays

LETTERS = dict(zip(RAY_KINDS, ("", "R", "T", "S"), strict=True))


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
        diagnosed = sentence_by_row(diagnose(judge, judgement))
        for path, row in zip(paths, film.row.tolist(), strict=True):
            answers = pixel_answers(judge, judgement, row, EXACT)
            yield PathRay(**_class_of(judge, judgement, diagnosed, row), path=path, answers=answers)


# ---- parts of the verdict


def _ray(rays: SharedRays) -> Json:
    return {name: _numbers(getattr(rays, name)[0]) for name in ("o", "d", "t_max", "start")}


def _exact(judge: Judge, answer: ExactAnswer | None) -> Json:
    """The exact answer for JSON; empty if there is no ray or no answer."""
    if answer is None:
        return {}
    scene, packed = judge.scene, judge.model.packed
    names = "shape", "prim", "where"
    ties = [dict(zip(names, each, strict=True)) for each in tie_members(scene, packed, answer)]
    return {"hit": answer.hit, "t": answer.distance, "ties": ties, "text": format_exact(scene, packed, answer)}


def _answer(scene: Scene, aovs: Aovs, t: Array, row: int = 0) -> Json:
    """One side's answer for JSON; a candidate may name no shape."""
    hit = bool(aovs.hit.ravel()[row])
    shape = int(aov_rows(aovs, "shape_id")[row]) if "shape_id" in aovs else -1
    name = scene.shape_names()[shape] if shape >= 0 else "a hit" if hit else "miss"
    values = {
        name: _numbers(aov_rows(aovs, name)[row]) for name in COMPARED_AOVS if name != "shape_id" and name in aovs
    }
    return {"hit": hit, "shape": name, "t": _numbers(t[row]), **values}


def _numbers(values: Any) -> Any:
    return np.asarray(values, np.float64).tolist()

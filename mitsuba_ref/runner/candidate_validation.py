"""A scene through a candidate, Mitsuba and exact arithmetic to its verdict."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from caster.scene.model import Scene
from mitsuba_ref.judge.aggregate import class_counts, defect_counts, largest_ratios
from mitsuba_ref.judge.candidate_formatting import candidate_failure, failure_hints
from mitsuba_ref.judge.candidate_judge import CandidateJudge, CandidateJudgement
from mitsuba_ref.judge.diagnosis import Diagnosis, diagnose
from mitsuba_ref.judge.scene_checks.render_checks import check_camera, check_sensor
from mitsuba_ref.judge.scene_checks.shape_checks import check_geometry, check_placement
from mitsuba_ref.judge.verdict import FAILING, MAX_LISTED_FAILURES, Failure, Finding, SceneCheck, SceneVerdict
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.rays import pixel_of
from mitsuba_ref.reference.rendering import trace_reference
from mitsuba_ref.reference.session import DEFAULT_TIMEOUT, SendRequest, send_request
from mitsuba_ref.report.candidate_evidence import SeenOfCandidate
from mitsuba_ref.report.candidate_images import write_images
from mitsuba_ref.subjects.answer import Answer, NoAnswer
from mitsuba_ref.subjects.requests import request_answer
from mitsuba_ref.subjects.subject import Candidate

# Of the checks of a scene, those of what a candidate is handed; the others are about our own caster.
CHECKS: tuple[Callable[[Scene], SceneCheck], ...] = (check_placement, check_geometry, check_camera)

# What `validate` judges of ours, and no candidate gives.
NEVER_GIVEN = ("position", "shading_normal", "shape_id", "diffuse")


def validate_candidate(
    candidate: Candidate,
    scene: Scene,
    name: str,
    path: str = "",
    *,
    folder: Path | None = None,
    timeout: float = DEFAULT_TIMEOUT,
    send: SendRequest = send_request,
    keep: bool = False,
) -> SceneVerdict:
    """The verdict of one scene; arguments as of `validate_scene`. What the candidate does wrong is in the verdict."""
    start = time.perf_counter()

    def ended(problem: str) -> SceneVerdict:
        x0, y0, x1, y1 = scene.film.window
        return SceneVerdict(
            name,
            path,
            (x1 - x0) * (y1 - y0),
            problem=problem,
            seconds=time.perf_counter() - start,
            size=(scene.film.width, scene.film.height),
            candidate=candidate.name,
            unjudged=NEVER_GIVEN,
        )

    try:
        heard = request_answer(candidate, scene)
    except NoAnswer as error:
        return ended(str(error))
    scene, model, rays, answer = heard.scene, heard.model, heard.rays, heard.answer
    witness = trace_reference(scene, model, rays, lights=False, timeout=timeout, send=send)
    if isinstance(witness, Crash):
        return ended(witness.message)
    judge = CandidateJudge(scene, model, rays, witness, answer)
    judgement = judge.judge()
    if folder:
        write_images(folder, name, judge, judgement)
    hit = answer.hit | witness.hit
    diagnosis = diagnose(judge, judgement)
    return SceneVerdict(
        name,
        path,
        len(answer.t),
        hit_pixels=int(hit.sum()),
        counts=class_counts(judgement, hit),
        ratios=largest_ratios(judgement),
        checks=(*(check(scene) for check in CHECKS), check_sensor(scene, witness)),
        failures=tuple(_failures(judge, judgement, diagnosis)),
        versions=witness.answer.versions,
        seconds=time.perf_counter() - start,
        reference_seconds=witness.answer.seconds,
        size=(scene.film.width, scene.film.height),
        adjudicated=len(judgement.exact.rows),
        exact_seconds=judgement.exact_seconds,
        cases=defect_counts(judgement),
        candidate=candidate.name,
        precision=answer.precision,
        unjudged=_unjudged(answer),
        findings=tuple(_findings(judge, diagnosis)),
        notes=(*answer.notes, *heard.limits, *failure_hints(answer, judgement)),
        seen=SeenOfCandidate(judge, judgement, diagnosis) if keep else None,
    )


def _unjudged(answer: Answer) -> tuple[str, ...]:
    missing = ("normal",) if answer.n is None else ()
    return (*missing, *NEVER_GIVEN)


def _findings(judge: CandidateJudge, diagnosis: Diagnosis) -> Sequence[Finding]:
    """Each sentence once, with the pixels it is said of, most first."""
    found = [
        Finding(len(rows), what, *pixel_of(judge.scene, int(rows[0])))
        for what, rows in diagnosis.said.items()
    ]
    return sorted(found, key=lambda finding: -finding.pixels)


def _failures(
    judge: CandidateJudge, judgement: CandidateJudgement, diagnosis: Diagnosis
) -> Sequence[Failure]:
    """Some of the pixels that fail: the first of each thing that is wrong, then others in order."""
    unlisted = np.array([row for row, case in judgement.cases.items() if case is None], np.int64)
    rows = np.union1d(np.flatnonzero(judgement.is_class(*FAILING)), unlisted)
    first = [int(each[0]) for each in sorted(diagnosis.said.values(), key=lambda each: -len(each))]
    order = list(dict.fromkeys([*first, *rows[:MAX_LISTED_FAILURES].tolist()]))[:MAX_LISTED_FAILURES]
    return [candidate_failure(judge, judgement, row, diagnosis.of(row)) for row in order]

"""A scene through both sides to its verdict."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from caster.rendering.images import Aovs, film_window
from caster.scene.files import load_scene
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.judge.aggregate import class_counts, defect_counts, largest_ratios
from mitsuba_ref.judge.classification import EXACT, Judge, Judgement, judge_of
from mitsuba_ref.judge.explanations import reason_with_factors
from mitsuba_ref.judge.formatting import exact_answer, format_exact
from mitsuba_ref.judge.scene_checks.bias import check_bias, error_statistics
from mitsuba_ref.judge.scene_checks.render_checks import CHECKS_WITHOUT_REFERENCE, check_sensor
from mitsuba_ref.judge.verdict import CLASSES, FAILING, MAX_LISTED_FAILURES, Failure, SceneVerdict, Verdict
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.rays import pixel_of
from mitsuba_ref.reference.session import DEFAULT_TIMEOUT, SendRequest, send_request
from mitsuba_ref.report.class_images import write_images
from mitsuba_ref.report.html.evidence_of_ours import EvidenceOfOurs
from mitsuba_ref.report.replay import with_replay
from mitsuba_ref.report.reproducers import StoredReproducers, write_reproducers


def validate(
    scene: Scene | str | Path,
    *,
    candidate: str | Callable[..., Any] | None = None,
    timeout: float = DEFAULT_TIMEOUT,
) -> Verdict:
    """Compare our caster with Mitsuba on one scene, given as a Scene or as the path of its file.

    candidate: somebody's ray caster in the place of ours: a function(scene, o, d) -> (t, n), or what --candidate takes
    (docs/candidates.md). Raises SceneError for a scene that is not valid, FileMissing where there is none,
    MissingReferenceError for a shape without a reference. A crash of Mitsuba is a verdict that does not pass. The
    verdict holds on to both pictures, for its write_html.
    """
    judge = validate_scene if candidate is None else _judge_of(candidate)
    if isinstance(scene, Scene):
        found = judge(scene, "scene", timeout=timeout, keep=True)
    else:
        found = judge(load_scene(scene), Path(scene).stem, str(scene), timeout=timeout, keep=True)
    return Verdict((with_replay(found),))


def _judge_of(candidate: str | Callable[..., Any]) -> Callable[..., SceneVerdict]:
    """How a scene is judged with a candidate in our place."""
    from functools import partial

    from mitsuba_ref.runner.candidate_validation import validate_candidate
    from mitsuba_ref.subjects.function import function_subject
    from mitsuba_ref.subjects.subject import parse_candidate

    asked = parse_candidate(candidate) if isinstance(candidate, str) else function_subject(candidate)
    return partial(validate_candidate, asked)


def validate_scene(
    scene: Scene,
    name: str,
    path: str = "",
    *,
    folder: Path | None = None,
    timeout: float = DEFAULT_TIMEOUT,
    send: SendRequest = send_request,
    keep: bool = False,
) -> SceneVerdict:
    """The verdict of one scene that is loaded.

    folder: where the pictures of both sides go; ask: the way to Mitsuba; keep: hold on to what the verdict rests on.
    """
    start = time.perf_counter()
    checks = tuple(check(scene) for check in CHECKS_WITHOUT_REFERENCE)
    judge = judge_of(scene, timeout=timeout, send=send)
    size, pixels = (scene.film.width, scene.film.height), film_window(scene)
    if isinstance(judge, Crash):
        problem = judge.message
        seconds = time.perf_counter() - start
        count = pixels.width * pixels.height
        return SceneVerdict(name, path, count, checks=checks, problem=problem, seconds=seconds, size=size)
    judgement, pair = judge.judge(), judge.pair
    stored = StoredReproducers((), 0)
    if folder:
        write_images(folder, name, scene, pair, judgement)
        stored = write_reproducers(folder, name, judge, judgement, path or name)
    hit = pair.ours.hit.ravel() | pair.witness.hit
    errors = error_statistics(judge.model.packed, pair, judge.bounds)
    by_check = _by_check(judgement)
    return SceneVerdict(
        name,
        path,
        len(pair.t),
        hit_pixels=int(hit.sum()),
        counts=class_counts(judgement, hit),
        ratios=largest_ratios(judgement),
        checks=(*checks, check_sensor(scene, pair.witness), check_bias(errors)),
        failures=tuple(_failures(judge, judgement)),
        versions=pair.witness.answer.versions,
        seconds=time.perf_counter() - start,
        reference_seconds=pair.witness.answer.seconds,
        size=size,
        allowed={name: check.ratio for name, check in scene.checks.items()},
        adjudicated=len(judgement.exact.rows),
        exact_seconds=judgement.exact_seconds,
        cases=defect_counts(judgement),
        statistics=errors,
        reproducers=stored.files,
        not_stored=stored.left_out,
        failing_by={check: len(rows) for check, rows in by_check.items()},
        worst_by={check: _failure(judge, judgement, int(rows[0]), check) for check, rows in by_check.items()},
        seen=EvidenceOfOurs(judge, judgement) if keep else None,
    )


def _failures(judge: Judge, judgement: Judgement) -> Sequence[Failure]:
    """The worst of the pixels that fail."""
    rows = _failing_rows(judgement)
    excess = np.array([judgement.excess(name)[rows] for name in judgement.names])
    order = np.argsort(-excess.max(axis=0), kind="stable")[:MAX_LISTED_FAILURES]
    return [_failure(judge, judgement, int(row)) for row in rows[order]]


def _failing_rows(judgement: Judgement) -> np.ndarray:
    unlisted = np.array([row for row, case in judgement.cases.items() if case is None], np.int64)
    return np.union1d(np.flatnonzero(judgement.is_class(*FAILING)), unlisted)


def _by_check(judgement: Judgement) -> dict[str, np.ndarray]:
    """Rows that fail, worst first, under every check that they fail; under `exact` where they fail none."""
    rows = _failing_rows(judgement)
    excess = {name: judgement.excess(name)[rows] for name in judgement.names}
    beyond = {name: ~(share <= 1.0) for name, share in excess.items()}
    beyond[EXACT] = beyond[EXACT] | ~np.any(list(beyond.values()), axis=0)
    order = {name: np.argsort(-share, kind="stable") for name, share in excess.items()}
    found = {name: rows[order[name]][beyond[name][order[name]]] for name in judgement.names}
    return {name: failing for name, failing in found.items() if len(failing)}


def _failure(judge: Judge, judgement: Judgement, i: int, check: str = "") -> Failure:
    """What became of row i; check: the one to speak of, the one that finds most unless told."""
    x, y = pixel_of(judge.scene, i)
    check = check or _offended(judgement, i)
    exact = format_exact(judge.scene, judge.model.packed, exact_answer(judge, judgement, i))
    ours, reference = (
        _words(judge.scene, aovs, check, i) for aovs in (judge.pair.ours, judge.pair.reference)
    )
    verdict, ratio = CLASSES[int(judgement.classes[i])], float(judgement.ratio(check)[i])
    return Failure(
        x, y, verdict, check, ratio, ours, reference, exact, reason_with_factors(judge, judgement, i)
    )


def _offended(judgement: Judgement, i: int) -> str:
    """The check that finds most; `exact`, which says the least of what is wrong, only where it is the only one."""
    excess = {name: float(judgement.excess(name)[i]) for name in judgement.names}
    telling = {name: share for name, share in excess.items() if name != EXACT and not share <= 1.0}
    return max(telling or excess, key=lambda name: excess[name])


def _words(scene: Scene, aovs: Aovs, check: str, i: int) -> str:
    """What one side says: the shape and its depth, and the value that was compared."""
    shape = int(aov_rows(aovs, "shape_id")[i])
    name = scene.shape_names()[shape] if shape >= 0 else "miss"
    words = f"{name} at depth {float(aov_rows(aovs, 'depth')[i])!r}"
    if check in ("position", "normal", "shading_normal", "diffuse"):
        value = ", ".join(
            f"{v:.9g}" if check != "position" else repr(float(v)) for v in aov_rows(aovs, check)[i]
        )
        words += f", {check} ({value})"
    return words

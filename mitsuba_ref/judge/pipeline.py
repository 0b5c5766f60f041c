"""The pipeline of a verdict: request, compare, adjudicate, classify, check, verdict (docs/method.md, in this order)."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from caster.geometry.packing import forget_packed
from caster.geometry.world_space import as_given
from caster.scene.model import Scene
from caster.system.terminal import report_stage
from mitsuba_ref.judge.aggregate import (
    class_counts,
    defect_counts,
    failing_by_check,
    failure_at,
    findings,
    kind_counts,
    listed_failures,
    merge_windows,
    quantities_not_given,
)
from mitsuba_ref.judge.checks import CANDIDATE, NOT_JUDGED, Scope, checks_of, make_checks
from mitsuba_ref.judge.checks import OURS as OF_OURS
from mitsuba_ref.judge.checks.bias import kind_biases
from mitsuba_ref.judge.checks.knife_edges import AimedFailure
from mitsuba_ref.judge.checks.ray_conventions import further_rays
from mitsuba_ref.judge.classification import Judge, Judgement, judge_of
from mitsuba_ref.judge.diagnosis import Cause, diagnose, sentence_by_row
from mitsuba_ref.judge.verdict import AGREE, EXCUSED, FAILING, TIE, SceneCheck, SceneVerdict
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.reference.mitsuba_process import DEFAULT_TIMEOUT, SendRequest, send_stored
from mitsuba_ref.reference.originals import original_of
from mitsuba_ref.reference.shared_input import SharedRays
from mitsuba_ref.subjects.bounce_films import BounceFilm
from mitsuba_ref.subjects.requests import SubjectResponse, request_answer
from mitsuba_ref.subjects.subject import OURS, NoAnswer, Subject, Unsupported


class Task(NamedTuple):
    """A scene to judge, and how."""

    scene: Scene
    name: str
    path: str = ""
    subject: Subject = OURS
    rays: SharedRays | None = None  # a list laid out as the film, in place of the camera's rays
    timeout: float = DEFAULT_TIMEOUT
    send: SendRequest = send_stored  # the way to Mitsuba
    thorough: bool = False  # make the checks of our caster beyond the film as well
    bounce: BounceFilm | None = None  # where the rays come from, if they are secondary ones

    @property
    def ours(self) -> bool:
        return self.subject is OURS

    def windows(self) -> list[Scene]:
        """The scene with each band of rows that is judged separately; a command renders the whole film at once."""
        x0, y0, x1, y1 = self.scene.film.window
        in_bands = (x1 - x0) * (y1 - y0) > LARGEST_WHOLE_FILM and self.subject.takes_rays and self.rays is None
        return list(self.scene.bands(BAND_PIXELS)) if in_bands else [self.scene]


class Seen(NamedTuple):
    """The evidence for the verdict of a window."""

    judge: Judge
    judgement: Judgement
    diagnosis: Sequence[Cause]
    wrong_rays: Sequence[AimedFailure]  # of the check `knife_edges`


# ---- a film, in one window or several ----

# A larger film is judged in bands, so that memory is that of one band. The pixels of a band cost
# more than the work that is done once for each band (its own scene in Mitsuba, samples of every check).
LARGEST_WHOLE_FILM, BAND_PIXELS = 1 << 20, 1 << 19

LARGE_SCENE = 1 << 20  # primitives; packing such a scene again costs less than keeping it beside its float32 numbers

# Called with the verdict of each window and the name of its images, while `seen` holds the evidence.
Finish = Callable[[SceneVerdict, str], SceneVerdict]


def judge_film(task: Task, finish: Finish) -> SceneVerdict:
    """The verdict of all bands, with the evidence of the one with most failures, or else of the middle one."""
    bands = task.windows()
    if len(bands) == 1:
        return finish(judge_window(task), task.name)
    verdicts: list[SceneVerdict] = []
    best, shown, seen = (-1, False, False), 0, None
    notes = [f"judged in {len(bands)} bands of at most {BAND_PIXELS} pixels"]
    for number, band in enumerate(bands):
        middle, (_, first, _, end) = number == len(bands) // 2, band.film.window
        found = judge_window(task._replace(scene=band), whole_scene=middle, whole_film=False)
        found = finish(found, f"{task.name}.rows-{first:05}-{end - 1:05}")
        rank = found.failing, not found.checks_pass, middle
        if rank > best:
            best, shown, seen = rank, number, found.seen
        verdicts.append(replace(found, seen=None))
        if found.problem:
            verdicts[-1] = replace(verdicts[-1], problem=f"rows {first} to {end - 1}: {found.problem}")
            break
    if seen is not None:
        _, first, _, end = bands[shown].film.window
        notes.append(f"pixels of the report: rows {first} to {end - 1}")
    merged = merge_windows([verdicts[shown], *verdicts[:shown], *verdicts[shown + 1 :]])
    return replace(merged, seen=seen, notes=(*notes, *merged.notes))


# ---- one window ----


def judge_window(task: Task, *, whole_scene: bool = True, whole_film: bool = True) -> SceneVerdict:
    """The verdict of the film's window.

    whole_scene: make also the checks that do not depend on the window; whole_film: no other window follows.
    """
    scopes: tuple[Scope, ...] = ("scene", "window") if whole_scene else ("window",)
    whose = OF_OURS if task.ours else CANDIDATE
    original = original_of(task.scene)
    camera = task.rays is None and (original is None or original.exact_camera)
    checks = checks_of(whose, scopes, thorough=task.thorough, camera=camera, secondary=task.bounce is not None)
    of_scene = [each for each in checks if not each.answered]
    inputs: dict[str, Any] = {"scene": task.scene, "subject": task.subject, "wrong_rays": []}
    inputs |= {"send": task.send, "timeout": task.timeout, "bounce": task.bounce and task.bounce.bounce}
    made = make_checks(of_scene, inputs) if task.ours else ()
    if whole_film:  # the rest is in float32; for ten million triangles, both packings take a gigabyte more
        forget_packed(task.scene, as_given, LARGE_SCENE)

    # Request: the subject's answer, then Mitsuba's along the same rays.
    report_stage("casting rays" if task.ours else "asking the candidate")
    try:
        response = request_answer(task.subject, task.scene, rays=task.rays)
    except NoAnswer as error:
        return _verdict_of(task, made, problem=str(error), unsupported=isinstance(error, Unsupported))
    report_stage("asking Mitsuba")
    judge = judge_of(response, timeout=task.timeout, send=task.send, with_files=whole_scene)
    if isinstance(judge, Crash):
        return _verdict_of(task, made, problem=judge.message)

    # Compare, adjudicate, classify; then find the causes of failing pixels.
    report_stage("judging")
    judgement = judge.judge()
    diagnosis = diagnose(judge, judgement, further_rays(task.subject, response.scene))

    # Check whatever pixels do not show.
    inputs |= {
        "scene": response.scene,
        "result": judge.result,
        "loaded": judge.result.answer.meshes,
        "failing": bool(judgement.is_class(*FAILING).any()),
        "judge": judge,
        "biases": tuple(kind_biases(judge, judgement.is_class(*EXCUSED))) if task.ours else (),
    }
    if not task.ours:
        made = make_checks(of_scene, inputs)
    made += make_checks([each for each in checks if each.answered], inputs)

    seen = Seen(judge, judgement, diagnosis, inputs["wrong_rays"])
    return replace(_verdict(task, response, seen, made), biases=inputs["biases"])


def _verdict(task: Task, response: SubjectResponse, seen: Seen, checks: tuple[SceneCheck, ...]) -> SceneVerdict:
    judge, judgement, diagnosis, _ = seen
    answer = judge.answer
    kinds = kind_counts(judgement, task.bounce) if task.bounce else {}
    by_check, by_row, agreeing = failing_by_check(judgement), sentence_by_row(diagnosis), judgement.is_class(AGREE)
    return _verdict_of(
        task,
        checks,
        hit_pixels=int(judge.any_hit.sum()),
        counts=class_counts(judgement, judge.any_hit),
        kinds=kinds,
        ratios={name: float(ratio[agreeing].max(initial=0.0)) for name, ratio in judgement.ratios.items()},
        failures=listed_failures(judge, judgement, diagnosis),
        versions=judge.result.answer.versions,
        reference_stored=judge.result.answer.stored,
        allowed=judgement.allowed,
        adjudicated=len(judgement.exact.rows),
        not_adjudicated=len(judgement.not_adjudicated),
        cases=defect_counts(judgement),
        failing_by={check: len(rows) for check, rows in by_check.items()},
        worst_by={check: failure_at(judge, judgement, by_row, int(rows[0]), check) for check, rows in by_check.items()},
        precision="" if task.ours else answer.precision,
        unjudged=quantities_not_given(answer),
        findings=findings(judge, diagnosis),
        notes=(
            *(original.coverage.lines() if (original := original_of(task.scene)) else ()),
            *(_notes_on_bounce(task.bounce, kinds) if task.bounce else _notes_on_hits(judge, judgement)),
            *(() if task.ours else (*answer.notes, *response.limits)),
            *(f"{each.name}: {each.what}" for each in checks if each.what.startswith(NOT_JUDGED)),
        ),
        seen=seen,
    )


def _verdict_of(task: Task, checks: tuple[SceneCheck, ...], **found: Any) -> SceneVerdict:
    film = task.scene.film
    x0, y0, x1, y1 = film.window
    return SceneVerdict(
        task.name,
        task.path,
        (x1 - x0) * (y1 - y0),
        checks=checks,
        size=(film.width, film.height),
        candidate=task.subject.name,
        coverage=original.coverage if (original := original_of(task.scene)) else None,
        bounce=task.bounce.bounce.number if task.bounce else 0,
        view=task.bounce.place if task.bounce else (0, 0, 0),
        **found,
    )


def _notes_on_bounce(film: BounceFilm, kinds: dict[str, dict[str, int]]) -> Iterator[str]:
    """The rays of each kind, such as "120 reflected (2 explained), 80 shadow", and how many are not judged."""
    words = []
    for kind, counts in kinds.items():
        others = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items() if name != AGREE)
        words.append(f"{sum(counts.values())} {kind}{f' ({others})' if others else ''}")
    yield f"rays: {', '.join(words)}"
    for why, count in film.bounce.left_out.items():
        yield f"{NOT_JUDGED}: {count} rays {why}, whose way depends on rounding"


def _notes_on_hits(judge: Judge, judgement: Judgement) -> Iterator[str]:
    """Where the shapes are and how the rays go, if nothing is hit; how many hits of a candidate are at t_min itself."""
    low, high = judge.model.boxes
    if not judge.any_hit.any() and len(low) and len(judge.o):
        middle = len(judge.o) // 2
        numbers = low.min(axis=0), high.max(axis=0), judge.o[middle], judge.d[middle]
        words = [", ".join(f"{v:.4g}" for v in each) for each in numbers]
        yield (
            f"the shapes lie between ({words[0]}) and ({words[1]}); the ray in the middle starts at ({words[2]}) "
            f"along ({words[3]})"
        )
    count = int((judge.hits_at_t_min & judgement.is_class(AGREE, TIE)).sum())
    if count:  # our own rays do not hit there
        yield f"{count} hits at t_min itself, of surfaces that rays start on: either answer is right"

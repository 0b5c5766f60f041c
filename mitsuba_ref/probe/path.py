"""The secondary rays of one pixel, each with its class and every answer."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from caster.rendering.bounces import RAY_KINDS
from caster.scene.model import Scene
from mitsuba_ref.judge.classification import EXACT, judge_of
from mitsuba_ref.judge.diagnosis import diagnose
from mitsuba_ref.judge.explanations import pixel_answers, reason
from mitsuba_ref.judge.verdict import AGREE, CLASSES, UNDECIDED
from mitsuba_ref.probe.candidate_pixel import Explained, case_text
from mitsuba_ref.reference.messages import Crash
from mitsuba_ref.subjects.bounce_films import bounce_films
from mitsuba_ref.subjects.requests import request_answer
from mitsuba_ref.subjects.subject import Subject

LETTERS = dict(zip(RAY_KINDS, ("", "R", "T", "S"), strict=True))
LEGEND = "\nsecondary rays by their paths: R reflected, T refracted, S to a light"


@dataclass(frozen=True, kw_only=True)
class PathRay(Explained):
    """One secondary ray and its verdict."""

    path: str  # a letter for each bounce, such as RTS
    answers: tuple[str, ...] = ()  # as text: the subject's, the reference's, the exact one


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
            yield PathRay(
                path=path,
                verdict=CLASSES[int(judgement.classes[row])],
                why=reason(judge, judgement, diagnosed, row),
                case=case_text(judgement, row),
                answers=pixel_answers(judge, judgement, row, EXACT),
            )


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

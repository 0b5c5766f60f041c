"""The verdict of a scene from its judgement: counts by class, largest ratios, findings and listed failures."""

from collections import Counter
from collections.abc import Mapping
from contextlib import suppress

import numpy as np

from caster.description.errors import SceneError
from caster.geometry.packing import packed
from caster.scene.model import Scene
from mitsuba_ref.error_model.intersections import KU, KU_OURS
from mitsuba_ref.judge.classification import CLASS_CODE, EXACT, Judge, Judgement
from mitsuba_ref.judge.diagnosis import Diagnosis, failing_rows
from mitsuba_ref.judge.explanations import full_reason, pixel_answers, reason
from mitsuba_ref.judge.verdict import (
    AGREE,
    CLASSES,
    FAILING,
    MAX_LISTED_FAILURES,
    UNLISTED,
    WRONG,
    Failure,
    Finding,
    SceneStatistics,
)
from mitsuba_ref.reference.rays import pixel_of
from mitsuba_ref.subjects.answer import FLOAT32, Answer

# What the judge compares of our caster, and no candidate gives.
NEVER_GIVEN = ("position", "shading_normal", "shape_id", "diffuse")


def quantities_not_given(answer: Answer) -> tuple[str, ...]:
    """What the judge compares, and this answer lacks."""
    if answer.images is not None:
        return ()
    if answer.hits_only:
        return ("depth", "normal", *NEVER_GIVEN)
    never = tuple(name for name in NEVER_GIVEN if name != "shape_id" or answer.shape_id is None)
    return never if answer.n is not None else ("normal", *never)


def class_counts(judgement: Judgement, hit: np.ndarray) -> dict[str, int]:
    """Hit pixels of each class; one that fails counts, whether anything is hit there or not."""
    counted = hit | judgement.is_class(*FAILING)
    numbers = np.bincount(judgement.classes[counted], minlength=len(CLASSES))
    return dict(zip(CLASSES, map(int, numbers), strict=True))


def largest_ratios(judgement: Judgement) -> dict[str, float]:
    """The largest ratio of each check among the pixels that agree."""
    agreeing = judgement.classes == CLASS_CODE[AGREE]
    return {name: float(judgement.ratio(name)[agreeing].max(initial=0.0)) for name in judgement.names}


def defect_counts(judgement: Judgement) -> dict[str, int]:
    """Number of pixels where the reference is wrong, by known case."""
    numbers = sorted(judgement.cases.values(), key=lambda case: (case is None, case))
    return dict(Counter(UNLISTED if case is None else str(case) for case in numbers))


def scene_statistics(scene: Scene) -> SceneStatistics:
    """Camera, shapes and number of primitives; the latter of a scene that can be packed."""
    count = 0
    with suppress(SceneError):
        count = int(packed(scene).first[-1])
    shapes = dict(Counter(str(shape.type) for shape in scene.shapes))
    return SceneStatistics(str(scene.camera.type), shapes, count)


def findings(judge: Judge, diagnosis: Diagnosis) -> tuple[Finding, ...]:
    """Each diagnosis once, with the pixels it is true of, most first."""
    found = [
        Finding(len(rows), what, *pixel_of(judge.scene, int(rows[0])))
        for what, rows in diagnosis.rows_of.items()
    ]
    return tuple(sorted(found, key=lambda finding: -finding.pixels))


def listed_failures(judge: Judge, judgement: Judgement, diagnosis: Diagnosis) -> tuple[Failure, ...]:
    """Some of the pixels that fail: one of each diagnosis, then the worst of the others.

    Of a diagnosis the worst pixel, or where a subject names no primitives, so that most have no factor, the first.
    """
    by_row, rows = diagnosis.by_row(), worst_first(judgement, failing_rows(judgement))
    order = rows if judge.names_prims else sorted(rows)
    leading = {by_row[row]: row for row in reversed(order)}
    most_first = sorted(leading.values(), key=lambda row: -len(diagnosis.rows_of[by_row[row]]))
    chosen = list(dict.fromkeys([*most_first, *rows]))[:MAX_LISTED_FAILURES]
    return tuple(failure_at(judge, judgement, by_row, row) for row in chosen)


def worst_first(judgement: Judgement, rows: np.ndarray) -> list[int]:
    """These rows of the image by the largest excess of any check."""
    excess = np.array([judgement.excess(name)[rows] for name in judgement.names])
    return [int(row) for row in rows[np.argsort(-excess.max(axis=0), kind="stable")]]


def failing_by_check(judgement: Judgement) -> dict[str, np.ndarray]:
    """Rows that fail, worst first, under every check that they fail; under `exact` where they fail none."""
    rows = failing_rows(judgement)
    excess = {name: judgement.excess(name)[rows] for name in judgement.names}
    beyond = {name: ~(ratio <= 1.0) for name, ratio in excess.items()}
    beyond[EXACT] = beyond[EXACT] | ~np.any(list(beyond.values()), axis=0)
    order = {name: np.argsort(-ratio, kind="stable") for name, ratio in excess.items()}
    found = {name: rows[order[name]][beyond[name][order[name]]] for name in judgement.names}
    return {name: failing for name, failing in found.items() if len(failing)}


def failure_at(
    judge: Judge, judgement: Judgement, diagnosed: Mapping[int, str], row: int, check: str = ""
) -> Failure:
    """One pixel that fails. check: the one to report; "": the one that finds most."""
    check = check or decisive_check(judgement, row)
    text = pixel_answers(judge, judgement, row, check)
    explain = full_reason if judge.names_prims else reason
    why = explain(judge, judgement, diagnosed, row)
    verdict, ratio = CLASSES[int(judgement.classes[row])], float(judgement.ratio(check)[row])
    x, y = pixel_of(judge.scene, row)
    return Failure(x, y, verdict, check, ratio, text.subject, text.reference, text.exact, why)


def decisive_check(judgement: Judgement, row: int) -> str:
    """The check that finds most; `exact`, the least specific one, only where it is the only one."""
    excess = {name: float(judgement.excess(name)[row]) for name in judgement.names}
    beyond = {name: ratio for name, ratio in excess.items() if name != EXACT and not ratio <= 1.0}
    return max(beyond or excess, key=lambda name: excess[name])


def failure_hints(answer: Answer, judgement: Judgement) -> tuple[str, ...]:
    """What may help where pixels fail: bounds are as wide as the round-off that they are made of."""
    if not judgement.is_class(*FAILING).any():
        return ()
    ratios = judgement.exact.ratio[judgement.is_class(WRONG)[judgement.exact.rows]]
    if answer.hints or answer.precision == FLOAT32 or not len(ratios) or ratios.max() > KU / KU_OURS:
        return answer.hints
    return (
        "every pixel that is wrong by the bounds of float64 is right by those of float32; if that will do: "
        "--candidate-precision float32",
    )

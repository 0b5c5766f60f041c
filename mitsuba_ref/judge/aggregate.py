"""The verdict of a scene from its judgement: counts by class, largest ratios, listed failures, the film as arrays."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from caster.aovs import Aovs
from caster.description.errors import SceneError
from caster.geometry.packing import packed
from caster.rendering.bounces import RAY_KINDS
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.judge.classification import EXACT, Judge, Judgement
from mitsuba_ref.judge.diagnosis import Cause, failing_rows, sentence_by_row
from mitsuba_ref.judge.explanations import full_reason, pixel_answers
from mitsuba_ref.judge.verdict import (
    CLASSES,
    FAILING,
    MAX_LISTED_FAILURES,
    UNLISTED,
    Failure,
    Finding,
    SceneStatistics,
    SceneVerdict,
)
from mitsuba_ref.reference.shared_input import pixel_of
from mitsuba_ref.subjects.bounce_films import BounceFilm
from mitsuba_ref.subjects.subject import Answer

# Quantities that the judge compares for our caster and that candidates do not give; some give ids of shapes.
NEVER_GIVEN = ("position", "shading_normal", "uv", "shape_id", "diffuse")


def quantities_not_given(answer: Answer) -> tuple[str, ...]:
    """Quantities that the judge compares and this answer lacks."""
    given = {"depth": not answer.hits_only, "normal": answer.n is not None, "shape_id": answer.shape_id is not None}
    if answer.images is not None:
        return () if "diffuse" in answer.images else ("diffuse",)
    names = ("depth", "normal", *NEVER_GIVEN)
    return tuple(name for name in names if not given.get(name))


def class_counts(judgement: Judgement, hit: Array) -> dict[str, int]:
    """Pixels of each class that are hit or fail."""
    counted = hit | judgement.is_class(*FAILING)
    numbers = np.bincount(judgement.classes[counted], minlength=len(CLASSES))
    return dict(zip(CLASSES, numbers.tolist(), strict=True))


def kind_counts(judgement: Judgement, film: BounceFilm) -> dict[str, dict[str, int]]:
    """Rays of each class that occurs, by their kind; misses included."""
    kinds, classes, found = film.bounce.rays.kind, judgement.classes[film.row], {}
    for kind in np.unique(kinds):
        codes, counts = np.unique(classes[kinds == kind], return_counts=True)
        found[RAY_KINDS[kind]] = {CLASSES[code]: count for code, count in zip(codes, counts.tolist(), strict=True)}
    return found


def defect_counts(judgement: Judgement) -> dict[str, int]:
    """Number of pixels where the reference is wrong, by known case."""
    numbers = sorted(judgement.cases.values(), key=lambda case: (case is None, case))
    return dict(Counter(str(case or UNLISTED) for case in numbers))


def scene_statistics(scene: Scene) -> SceneStatistics:
    """Camera, shapes, and the number of primitives if the scene can be packed."""
    count = 0
    with suppress(SceneError):
        count = int(packed(scene).first[-1])
    shapes = dict(Counter(str(shape.type) for shape in scene.shapes))
    return SceneStatistics(str(scene.camera.type), shapes, count)


def findings(judge: Judge, diagnosis: Sequence[Cause]) -> tuple[Finding, ...]:
    """Each cause once, most pixels first."""
    ordered = sorted(diagnosis, key=lambda each: -len(each.rows))
    return tuple(
        Finding(
            len(each.rows),
            each.what,
            *pixel_of(judge.scene, int(each.rows[0])),
            each.of,
            each.remedy,
            each.where,
            len(each.alike),
        )
        for each in ordered
    )


def listed_failures(judge: Judge, judgement: Judgement, diagnosis: Sequence[Cause]) -> tuple[Failure, ...]:
    """Some of the pixels that fail: one of each diagnosis, then the worst of the others, first those looked at.

    The worst pixel of a diagnosis, or the first if the subject names no primitives, so that most have no factor.
    """
    by_row, rows = sentence_by_row(diagnosis), failing_rows(judgement)
    excess = np.max([judgement.excess(name)[rows] for name in judgement.ratios], axis=0)
    alike = np.isin(rows, np.concatenate([each.alike for each in diagnosis])) if len(rows) else rows
    worst_first = rows[np.lexsort([-excess, alike])].tolist()
    rank = {row: place for place, row in enumerate(worst_first if judge.names_prims else rows.tolist())}
    causes = sorted((cause.rows for cause in diagnosis), key=len, reverse=True)
    leading = [min(cause_rows.tolist(), key=rank.__getitem__) for cause_rows in causes]
    chosen = list(dict.fromkeys([*leading, *worst_first]))[:MAX_LISTED_FAILURES]
    return tuple(failure_at(judge, judgement, by_row, row) for row in chosen)


def failing_by_check(judgement: Judgement) -> dict[str, Array]:
    """Failing rows by each check that they fail, worst first; under `exact` if they fail none."""
    rows = failing_rows(judgement)
    excess = {name: judgement.excess(name)[rows] for name in judgement.ratios}
    beyond = {name: ~(ratio <= 1.0) for name, ratio in excess.items()}
    beyond[EXACT] |= ~np.any(list(beyond.values()), axis=0)
    worst_first = {name: np.argsort(-ratio, kind="stable") for name, ratio in excess.items()}
    return {name: rows[order[beyond[name][order]]] for name, order in worst_first.items() if beyond[name].any()}


def failure_at(judge: Judge, judgement: Judgement, diagnosed: Mapping[int, str], row: int, check: str = "") -> Failure:
    """One pixel that fails. check: the check to report; "": the one with the largest excess."""
    check = check or decisive_checks(judgement, np.array([row]))[0]
    answers = pixel_answers(judge, judgement, row, check)
    why = full_reason(judge, judgement, diagnosed, row)
    verdict, ratio = CLASSES[int(judgement.classes[row])], float(judgement.ratios[check][row])
    x, y = pixel_of(judge.scene, row)
    return Failure(x, y, verdict, check, ratio, *answers, why)


def decisive_checks(judgement: Judgement, rows: Array) -> list[str]:
    """The check with the largest excess of each row; `exact`, the least specific, only if no other fails."""
    names = list(judgement.ratios)
    excess = np.stack([judgement.excess(name)[rows] for name in names])
    beyond = (excess > 1.0) & (np.array(names) != EXACT)[:, None]
    ranked = np.where(beyond | ~beyond.any(axis=0), excess, -1.0)
    return [names[i] for i in ranked.argmax(axis=0)]


# ---- the film as arrays: the class of each pixel, both images, and every failing pixel with its numbers ----

VALUES_OF = {
    "mask": "hit",
    "on_surface": "depth",
    EXACT: "depth",
}  # check -> AOV that it is about; others by their name


class FailingPixel(NamedTuple):
    """A pixel that fails its scene, by the check that exceeds its bound the most."""

    x: int  # in the film
    y: int
    verdict: str  # its class: wrong, undecided, or reference_wrong in no known way
    check: str  # such as depth or normal; exact: against exact arithmetic
    ratio: float  # error over bound; inf where no error is allowed
    bound: float  # of the error, in the unit of the values; nan where exact arithmetic or light decides
    subject: Any  # the judged value, a number or an array (c,); None where it is not given
    reference: Any  # Mitsuba's


@dataclass(frozen=True)
class JudgedFilm:
    """The film's window, of h x w pixels, or of bands of it from top to bottom."""

    classes: NDArray[np.uint8]  # (h, w) index into mitsuba_ref.CLASSES
    images: dict[str, Aovs]  # "ours": the subject's, or the candidate's; "reference": Mitsuba's
    failing: tuple[FailingPixel, ...]  # row by row


def judged_film(judge: Judge, judgement: Judgement) -> JudgedFilm:
    """The film of one window."""
    classes = judgement.classes.astype(np.uint8).reshape(judge.shape)
    images = {"ours": judge.subject, "reference": judge.pair.reference}
    return JudgedFilm(classes, images, tuple(_failing(judge, judgement)))


def _failing(judge: Judge, judgement: Judgement) -> Iterator[FailingPixel]:
    own, rows = judge.own, failing_rows(judgement)
    # Bounds on the error of each check that has one, in the unit of its values; 0 for numbers and hits.
    bounds = dict.fromkeys(("mask", "shape_id", "prim_id"), np.zeros(len(judge.hit)))
    bounds |= {"normal": own.n_error, "depth": (own.t_error + judge.answer.t_rounding) * judge.length}
    bounds["on_surface"] = bounds["depth"]
    if judge.names_prims:
        bounds |= judge.allowed_distance
    for row, check in zip(rows.tolist(), decisive_checks(judgement, rows), strict=True):
        name, ratio = VALUES_OF.get(check, check), float(judgement.ratios[check][row])
        x, y = pixel_of(judge.scene, row)
        sides = (_value(aovs, name, row) for aovs in (judge.subject, judge.pair.reference))
        bound = float(bounds[check][row]) if check in bounds else np.nan
        yield FailingPixel(x, y, CLASSES[int(judgement.classes[row])], check, ratio, bound, *sides)


def _value(aovs: Aovs, name: str, row: int) -> Any:
    if name == "hit":
        return bool(aovs.hit.ravel()[row])
    if name not in aovs:
        return None
    value = aov_rows(aovs, name)[row]
    return value.item() if value.ndim == 0 else value


def joined(bands: Sequence[JudgedFilm]) -> JudgedFilm:
    """One film of bands of whole rows, from top to bottom."""
    if len(bands) == 1:
        return bands[0]
    images = {}
    for side in bands[0].images:
        parts = [band.images[side] for band in bands]
        names = [name for name in parts[0] if all(name in part for part in parts)]
        whole = {name: np.concatenate([part[name] for part in parts]) for name in names}
        images[side] = Aovs(whole, np.concatenate([part.hit for part in parts]))
    failing = tuple(pixel for band in bands for pixel in band.failing)
    return JudgedFilm(np.concatenate([band.classes for band in bands]), images, failing)


# ---- the windows of a large film, judged one after the other ----


SUMS = ("pixels", "hit_pixels", "seconds", "adjudicated", "not_adjudicated", "not_stored")
COUNTS = ("counts", "cases", "failing_by")


def merge_windows(windows: Sequence[SceneVerdict]) -> SceneVerdict:
    """The verdict of a film from those of its windows, with the biases of the one that the report shows.

    Numbers are added up, and the largest ratios are kept; one failure of each reason is listed first, then the worst. A
    window without a comparison is a problem of the whole film.
    """
    sums: dict[str, Any] = {name: sum(getattr(window, name) for window in windows) for name in SUMS}
    counts: dict[str, Any] = {name: Counter() for name in COUNTS}
    for window in windows:
        for name, count in counts.items():
            count.update(getattr(window, name))
    failures = [failure for window in windows for failure in window.failures]
    one_of_each = {failure.reason: failure for failure in reversed(failures)}
    listed = dict.fromkeys([*reversed(one_of_each.values()), *sorted(failures, key=_badness, reverse=True)])
    longest_first = sorted(windows, key=lambda window: -len(window.checks))
    checks = _largest([{check.name: check for check in window.checks} for window in longest_first])
    return replace(
        windows[0],
        **sums,
        **counts,
        ratios=_largest([window.ratios for window in windows]),
        checks=tuple(checks.values()),
        failures=tuple(listed)[:MAX_LISTED_FAILURES],
        reference_stored=all(window.reference_stored for window in windows),
        problem=next((window.problem for window in windows if window.problem), ""),
        reproducers=tuple(file for window in windows for file in window.reproducers),
        worst_by=_largest([window.worst_by for window in windows]),
        findings=_merged_findings(windows),
        notes=tuple(dict.fromkeys(note for window in windows for note in window.notes)),
    )


def _largest(windows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The largest entry of each name, the first of several; entries are numbers or have a ratio."""
    items = [item for window in windows for item in window.items()]
    found = dict(sorted(reversed(items), key=lambda item: _badness(item[1])))
    return {name: found[name] for name, _ in items}


def _badness(entry: Any) -> tuple[bool, float]:
    """A sort key that puts NaN beyond every number."""
    ratio = getattr(entry, "ratio", entry)
    return (not ratio <= np.inf, ratio)


def _merged_findings(windows: Sequence[SceneVerdict]) -> tuple[Finding, ...]:
    """Each diagnosis once, most pixels first."""
    merged: dict[str, Finding] = {}
    for more in chain.from_iterable(window.findings for window in windows):
        if first := merged.get(more.what):
            pixels, of, alike = first.pixels + more.pixels, first.of + more.of, first.alike + more.alike
            more = replace(first, pixels=pixels, of=of, alike=alike)
        merged[more.what] = more
    return tuple(sorted(merged.values(), key=lambda each: -each.pixels))

"""The judged film as arrays: the class of each pixel, both images, and every failing pixel with its numbers."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from caster.aovs import Aovs
from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.judge.aggregate import decisive_checks
from mitsuba_ref.judge.classification import EXACT, Judge, Judgement
from mitsuba_ref.judge.diagnosis import failing_rows
from mitsuba_ref.judge.verdict import CLASSES
from mitsuba_ref.reference.shared_input import pixel_of

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
    pair = judge.pair
    classes = judgement.classes.astype(np.uint8).reshape(pair.shape)
    return JudgedFilm(classes, {"ours": pair.subject, "reference": pair.reference}, tuple(_failing(judge, judgement)))


def _failing(judge: Judge, judgement: Judgement) -> Iterator[FailingPixel]:
    pair, bounds = judge.pair, {name: check_bound(judge, name) for name in judgement.ratios}
    rows = failing_rows(judgement)
    for row, check in zip(rows.tolist(), decisive_checks(judgement, rows), strict=True):
        name, ratio = VALUES_OF.get(check, check), float(judgement.ratios[check][row])
        x, y = pixel_of(judge.scene, row)
        sides = (_value(aovs, name, row) for aovs in (pair.subject, pair.reference))
        yield FailingPixel(x, y, CLASSES[int(judgement.classes[row])], check, ratio, float(bounds[check][row]), *sides)


def _value(aovs: Aovs, name: str, row: int) -> Any:
    if name == "hit":
        return bool(aovs.hit.ravel()[row])
    if name not in aovs:
        return None
    value = aov_rows(aovs, name)[row]
    return value.item() if value.ndim == 0 else value


def check_bound(judge: Judge, check: str) -> np.ndarray:
    """(n,) the bound on the error of a check, in the unit of its values: 0 for numbers and hits, nan if unknown."""
    own, pixels = judge.bounds.own, judge.pixels
    if check in ("mask", "shape_id", "prim_id"):
        return np.zeros(len(judge.hit))
    if judge.names_prims and check in pixels.allowed_distance:
        return pixels.allowed_distance[check]
    if check == "normal":
        return own.n_error
    if check in ("depth", "on_surface"):
        return (own.t_error + judge.answer.t_rounding) * pixels.length
    return np.full(len(judge.hit), np.nan)


def joined(bands: Sequence[JudgedFilm]) -> JudgedFilm:
    """One film of bands of whole rows, from top to bottom."""
    if len(bands) == 1:
        return bands[0]
    images = {side: _stacked([band.images[side] for band in bands]) for side in bands[0].images}
    failing = tuple(pixel for band in bands for pixel in band.failing)
    return JudgedFilm(np.concatenate([band.classes for band in bands]), images, failing)


def _stacked(bands: Sequence[Aovs]) -> Aovs:
    names = [name for name in bands[0] if all(name in band for band in bands)]
    return Aovs(
        {name: np.concatenate([band[name] for band in bands]) for name in names},
        np.concatenate([band.hit for band in bands]),
    )

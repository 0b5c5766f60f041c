"""The data of one scene on the report's page, in parts: verdict, findings of each pixel, and both images."""

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from mitsuba_ref.error_model.bounds import aov_rows
from mitsuba_ref.judge.classification import CLASS_CODE
from mitsuba_ref.judge.formatting import format_exact_hit
from mitsuba_ref.judge.verdict import AGREE, CLASSES, FAILING, REFERENCE_WRONG, SceneVerdict
from mitsuba_ref.oracle.oracle import ExactAnswer
from mitsuba_ref.report.html.encoding import coarse, narrowest, packed, rounded, thumbnail
from mitsuba_ref.report.html.evidence import Evidence

MAX_PIXELS_WITH_REASON = 1 << 16  # of a scene, failing ones first: half a second of work


class TextTable:
    """Distinct texts, numbered."""

    def __init__(self) -> None:
        self.numbers: dict[str, int] = {}

    def number(self, text: str) -> int:
        return self.numbers.setdefault(text, len(self.numbers))

    def numbers_of(self, texts: Iterable[str]) -> np.ndarray:
        return np.array([self.number(text) for text in texts], np.int32)


def reasons(evidence: Evidence) -> dict[str, Any]:
    """Rows of pixels that are not in class `agree`, failing ones first, with a reason for each."""
    judgement = evidence.judgement
    rows = np.flatnonzero(judgement.classes != CLASS_CODE[AGREE])
    unlisted = np.array([judgement.cases.get(int(row), 0) is None for row in rows], bool)
    fails = judgement.is_class(*FAILING)[rows] | unlisted
    rows = rows[np.argsort(~fails, kind="stable")]
    explained, texts = rows[:MAX_PIXELS_WITH_REASON], TextTable()
    why = texts.numbers_of(evidence.why(int(row)) for row in explained)
    return {
        "rows": packed(explained.astype(np.int32)),
        "why": packed(why),
        "texts": list(texts.numbers),
        "always": {CLASSES.index(name): text for name, text in evidence.always.items()},
        "left_out": len(rows) - len(explained),
    }


def exact_answers(evidence: Evidence) -> dict[str, Any]:
    """The exact answer of each adjudicated pixel."""
    exact = evidence.judgement.exact
    texts = TextTable()
    words = texts.numbers_of(_answer_text(evidence, answer) for answer in exact.answers)
    return {
        "rows": packed(exact.rows.astype(np.int32)),
        "t": packed(np.array([_exact_t(answer) for answer in exact.answers], np.float64)),
        "share": packed(coarse(exact.ratio)),
        "words": packed(words),
        "texts": list(texts.numbers),
        "adjudicated": len(exact.rows),
    }


def _answer_text(evidence: Evidence, answer: ExactAnswer | None) -> str:
    return format_exact_hit(evidence.scene, evidence.packed, answer)


def _exact_t(answer: ExactAnswer | None) -> float:
    """inf on a miss, NaN without an answer."""
    if answer is None:
        return np.nan
    return np.inf if answer.t is None else float(answer.t)


UNLISTED_CODE = len(CLASSES)  # a class of the page: the reference is wrong in no known way, which fails

# Layers, the most important first, where not all fit into one file; "ratio" is the largest of all checks.
PIXEL_LAYERS = ("ids", "ratio", "depth", "normal", "diffuse", "shading_normal", "position")
FLOAT_LAYERS = ("depth", "normal", "diffuse", "shading_normal", "position")


class SceneRecord(NamedTuple):
    """One scene. All but the thumbnail can be written as JSON."""

    about: dict[str, Any]
    layers: dict[str, dict[str, Any]]
    thumbnail: str  # PNG as a data URI


def scene_record(verdict: SceneVerdict, evidence: Evidence, *, exact: bool) -> SceneRecord:
    """exact: both images to the bit and every bound; otherwise as float32, a third of the size."""
    hit = evidence.ours.hit.ravel() + 2 * evidence.reference.hit.ravel()
    about = {
        "verdict": verdict.to_dict(),
        "window": list(evidence.scene.film.window),
        "shapes": list(evidence.scene.shape_names()),
        "exactly": exact,
        "class": packed(classes(evidence)),
        "hit": packed(hit.astype(np.uint8)),
        "reasons": reasons(evidence),
        "exact": exact_answers(evidence),
    }
    if exact:
        judgement = evidence.judgement
        others = [name for name in judgement.names if name not in FLOAT_LAYERS]
        about["shares"] = {name: packed(coarse(judgement.ratio(name))) for name in others}
    return SceneRecord(about, dict(layers(evidence, exact=exact)), thumbnail(evidence.ours))


def classes(evidence: Evidence) -> np.ndarray:
    """(n,) uint8 class of each pixel, UNLISTED_CODE among them."""
    found = evidence.judgement.classes.astype(np.uint8)
    unlisted = [row for row, case in evidence.judgement.cases.items() if case is None]
    found[unlisted] = np.where(found[unlisted] == CLASS_CODE[REFERENCE_WRONG], UNLISTED_CODE, found[unlisted])
    return found


def layers(evidence: Evidence, *, exact: bool) -> Iterator[tuple[str, dict[str, Any]]]:
    """The available layers: an AOV may be missing on either side."""
    judgement = evidence.judgement
    yield "ids", ids(evidence, exact=exact)
    worst = np.max([judgement.ratio(name) for name in judgement.names], axis=0)
    yield "ratio", {"ratio": packed(coarse(worst))}
    for name in FLOAT_LAYERS:
        if name in evidence.ours and name in evidence.reference:
            sides = values(aov_rows(evidence.ours, name), aov_rows(evidence.reference, name), exact=exact)
            yield name, sides | (bounds(evidence, name) if exact else {})


def values(ours: np.ndarray, reference: np.ndarray, *, exact: bool) -> dict[str, Any]:
    """Both sides, ours as the XOR of the bits."""
    if exact:
        return {"reference": packed(narrowest(reference)), "ours": packed(ours, narrowest(reference))}
    return {"reference": packed(rounded(reference)), "ours": packed(rounded(ours), rounded(reference))}


def bounds(evidence: Evidence, name: str) -> dict[str, Any]:
    """Error over bound of the check of this name, and that bound, if there is one."""
    bound = evidence.bound(name)
    found = {"ratio": packed(coarse(evidence.judgement.ratio(name)))}
    if bound.between is not None:
        found["bound"] = packed(coarse(bound.between))
    if bound.alone is not None:
        found["alone"] = packed(bound.alone.astype(np.uint8))
    if bound.own is not None:
        found["own"] = packed(coarse(bound.own))
    return found


def ids(evidence: Evidence, *, exact: bool) -> dict[str, Any]:
    """Shape, and primitive within it, of both sides, -1 on a miss; and t, where depth does not determine it."""
    found = {name: packed(numbers.astype(np.int32)) for name, numbers in evidence.ids().items()}
    t = evidence.t()
    sides = {} if t is None else values(*t, exact=exact)
    return found | {f"t_{side}": each for side, each in sides.items()}

"""What is known of single pixels in words: why they have their class, and the exact answers."""

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

MAX_PIXELS_WITH_REASON = (
    1 << 16
)  # pixels of a scene whose class is given a reason, the failing first: half a second of work


class TextTable:
    """Texts by number."""

    def __init__(self) -> None:
        self.numbers: dict[str, int] = {}

    def number(self, text: str) -> int:
        return self.numbers.setdefault(text, len(self.numbers))

    def numbers_of(self, texts: Iterable[str]) -> np.ndarray:
        return np.array([self.number(text) for text in texts], np.int32)


def reasons(seen: Evidence) -> dict[str, Any]:
    """Rows of the picture that do not plainly agree, failing ones first, and a sentence for each."""
    judgement = seen.judgement
    rows = np.flatnonzero(judgement.classes != CLASS_CODE[AGREE])
    unlisted = np.array([judgement.cases.get(int(row), 0) is None for row in rows], bool)
    fails = judgement.is_class(*FAILING)[rows] | unlisted
    rows = rows[np.argsort(~fails, kind="stable")]
    said, texts = rows[:MAX_PIXELS_WITH_REASON], TextTable()
    why = texts.numbers_of(seen.why(int(row)) for row in said)
    return {
        "rows": packed(said.astype(np.int32)),
        "why": packed(why),
        "texts": list(texts.numbers),
        "always": {CLASSES.index(name): text for name, text in seen.always.items()},
        "left_out": len(rows) - len(said),
    }


def exact_answers(seen: Evidence) -> dict[str, Any]:
    """What exact arithmetic said, of each pixel that it was asked about."""
    exact = seen.judgement.exact
    texts = TextTable()
    words = texts.numbers_of(_answer_text(seen, answer) for answer in exact.answers)
    return {
        "rows": packed(exact.rows.astype(np.int32)),
        "t": packed(np.array([_exact_t(answer) for answer in exact.answers], np.float64)),
        "share": packed(coarse(exact.share)),
        "words": packed(words),
        "texts": list(texts.numbers),
        "asked": len(exact.rows),
    }


def _answer_text(seen: Evidence, answer: ExactAnswer | None) -> str:
    return format_exact_hit(seen.scene, seen.packed, answer)


def _exact_t(answer: ExactAnswer | None) -> float:
    """inf on a miss, NaN without an answer."""
    if answer is None:
        return np.nan
    return np.inf if answer.t is None else float(answer.t)


# What the page is told about one scene, in parts: its verdict, what is known of each pixel, and both pictures.


UNLISTED_CODE = len(CLASSES)  # a class of the page's own: the reference is wrong in no known way, which fails

# Pictures in the order in which they are given up last where space is short; "ratio" is the worst of all checks.
PIXEL_LAYERS = ("ids", "ratio", "depth", "normal", "diffuse", "shading_normal", "position")
FLOAT_LAYERS = ("depth", "normal", "diffuse", "shading_normal", "position")


class SceneRecord(NamedTuple):
    """One scene. All but the thumbnail can be written as JSON."""

    about: dict[str, Any]
    layers: dict[str, dict[str, Any]]
    thumbnail: str  # PNG as a data URI


def scene_record(verdict: SceneVerdict, seen: Evidence, *, exact: bool) -> SceneRecord:
    """exact: both pictures to the bit and every bound; otherwise as float32, which takes a third of the space."""
    hit = seen.ours.hit.ravel() + 2 * seen.reference.hit.ravel()
    about = {
        "verdict": verdict.to_dict(),
        "window": list(seen.scene.film.window),
        "shapes": list(seen.scene.shape_names()),
        "exactly": exact,
        "class": packed(classes(seen)),
        "hit": packed(hit.astype(np.uint8)),
        "reasons": reasons(seen),
        "exact": exact_answers(seen),
    }
    if exact:
        judgement = seen.judgement
        others = [name for name in judgement.names if name not in FLOAT_LAYERS]
        about["shares"] = {name: packed(coarse(judgement.ratio(name))) for name in others}
    return SceneRecord(about, dict(layers(seen, exact=exact)), thumbnail(seen.ours))


def classes(seen: Evidence) -> np.ndarray:
    """(n,) uint8 class of each pixel, UNLISTED_CODE among them."""
    found = seen.judgement.classes.astype(np.uint8)
    unlisted = [row for row, case in seen.judgement.cases.items() if case is None]
    found[unlisted] = np.where(found[unlisted] == CLASS_CODE[REFERENCE_WRONG], UNLISTED_CODE, found[unlisted])
    return found


def layers(seen: Evidence, *, exact: bool) -> Iterator[tuple[str, dict[str, Any]]]:
    """What there is of LAYERS: an AOV may be missing on either side."""
    judgement = seen.judgement
    yield "ids", ids(seen, exact=exact)
    worst = np.max([judgement.ratio(name) for name in judgement.names], axis=0)
    yield "ratio", {"ratio": packed(coarse(worst))}
    for name in FLOAT_LAYERS:
        if name in seen.ours and name in seen.reference:
            sides = values(aov_rows(seen.ours, name), aov_rows(seen.reference, name), exact=exact)
            yield name, sides | (bounds(seen, name) if exact else {})


def values(ours: np.ndarray, reference: np.ndarray, *, exact: bool) -> dict[str, Any]:
    """Both sides, ours as what its bits differ by."""
    if exact:
        return {"reference": packed(narrowest(reference)), "ours": packed(ours, narrowest(reference))}
    return {"reference": packed(rounded(reference)), "ours": packed(rounded(ours), rounded(reference))}


def bounds(seen: Evidence, name: str) -> dict[str, Any]:
    """Error over bound of the check of this name, and that bound, if there is one."""
    bound = seen.bound(name)
    found = {"ratio": packed(coarse(seen.judgement.ratio(name)))}
    if bound.between is not None:
        found["bound"] = packed(coarse(bound.between))
    if bound.alone is not None:
        found["alone"] = packed(bound.alone.astype(np.uint8))
    if bound.own is not None:
        found["own"] = packed(coarse(bound.own))
    return found


def ids(seen: Evidence, *, exact: bool) -> dict[str, Any]:
    """Shape, and primitive within its shape, of both sides, -1 on a miss; and t, where depth does not say it all."""
    found = {name: packed(numbers.astype(np.int32)) for name, numbers in seen.ids().items()}
    t = seen.t()
    sides = {} if t is None else values(*t, exact=exact)
    return found | {f"t_{side}": each for side, each in sides.items()}

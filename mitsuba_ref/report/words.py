"""What is known of single pixels in words: why they have their class, and the exact answers."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from mitsuba_ref.exact import ExactAnswer
from mitsuba_ref.judge import CODE
from mitsuba_ref.report.arrays import coarse, packed
from mitsuba_ref.report.seen import Seen
from mitsuba_ref.telling import hit_words
from mitsuba_ref.verdict import AGREE, CLASSES, FAILING

MOST = 1 << 16  # pixels of a scene whose class is given a reason, the failing first: half a second of work


class Vocabulary:
    """Texts by number."""

    def __init__(self) -> None:
        self.numbers: dict[str, int] = {}

    def number(self, text: str) -> int:
        return self.numbers.setdefault(text, len(self.numbers))

    def numbers_of(self, texts: Iterable[str]) -> np.ndarray:
        return np.array([self.number(text) for text in texts], np.int32)


def reasons(seen: Seen) -> dict[str, Any]:
    """Rows of the picture that do not plainly agree, failing ones first, and a sentence for each."""
    judgement = seen.judgement
    rows = np.flatnonzero(judgement.classes != CODE[AGREE])
    unlisted = np.array([judgement.cases.get(int(row), 0) is None for row in rows], bool)
    fails = judgement.is_class(*FAILING)[rows] | unlisted
    rows = rows[np.argsort(~fails, kind="stable")]
    said, texts = rows[:MOST], Vocabulary()
    why = texts.numbers_of(seen.why(int(row)) for row in said)
    return {
        "rows": packed(said.astype(np.int32)),
        "why": packed(why),
        "texts": list(texts.numbers),
        "always": {CLASSES.index(name): text for name, text in seen.always.items()},
        "left_out": len(rows) - len(said),
    }


def exact_answers(seen: Seen) -> dict[str, Any]:
    """What exact arithmetic said, of each pixel that it was asked about."""
    exact = seen.judgement.exact
    texts = Vocabulary()
    words = texts.numbers_of(_words(seen, answer) for answer in exact.answers)
    return {
        "rows": packed(exact.rows.astype(np.int32)),
        "t": packed(np.array([_t(answer) for answer in exact.answers], np.float64)),
        "share": packed(coarse(exact.share)),
        "words": packed(words),
        "texts": list(texts.numbers),
        "asked": len(exact.rows),
    }


def _words(seen: Seen, answer: ExactAnswer | None) -> str:
    return hit_words(seen.scene, seen.packed, answer)


def _t(answer: ExactAnswer | None) -> float:
    """inf on a miss, NaN without an answer."""
    if answer is None:
        return np.nan
    return np.inf if answer.t is None else float(answer.t)

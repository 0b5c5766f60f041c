"""What a verdict says of all pixels of a scene together, whoever was judged."""

from collections import Counter
from typing import Protocol

import numpy as np

from mitsuba_ref.judge import CODE
from mitsuba_ref.verdict import AGREE, CLASSES, FAILING, UNLISTED


class Found(Protocol):
    """Of a judgement, what is summed up here; one row a pixel."""

    @property
    def classes(self) -> np.ndarray: ...

    @property
    def cases(self) -> dict[int, int | None]: ...

    @property
    def names(self) -> tuple[str, ...]: ...

    def ratio(self, name: str) -> np.ndarray: ...

    def is_class(self, *names: str) -> np.ndarray: ...


def counts_of(judgement: Found, hit: np.ndarray) -> dict[str, int]:
    """Hit pixels of each class; one that fails counts, whether anybody hit there or not."""
    counted = hit | judgement.is_class(*FAILING)
    numbers = np.bincount(judgement.classes[counted], minlength=len(CLASSES))
    return dict(zip(CLASSES, map(int, numbers), strict=True))


def ratios_of(judgement: Found) -> dict[str, float]:
    """The largest ratio of each check among the pixels that agree."""
    agreeing = judgement.classes == CODE[AGREE]
    return {name: float(judgement.ratio(name)[agreeing].max(initial=0.0)) for name in judgement.names}


def cases_of(judgement: Found) -> dict[str, int]:
    """How many pixels where the reference is wrong are of which known case."""
    numbers = sorted(judgement.cases.values(), key=lambda case: (case is None, case))
    return dict(Counter(UNLISTED if case is None else str(case) for case in numbers))

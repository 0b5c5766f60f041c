"""What a verdict says of all pixels of a scene together, whoever was judged."""

from collections import Counter
from contextlib import suppress
from typing import Protocol

import numpy as np

from caster.description.errors import SceneError
from caster.geometry.packing import packed
from caster.scene.model import Scene
from mitsuba_ref.judge.classification import CLASS_CODE
from mitsuba_ref.judge.verdict import AGREE, CLASSES, FAILING, UNLISTED, SceneStatistics


class ClassifiedPixels(Protocol):
    """Of a judgement, what is summed up here; one row a pixel."""

    @property
    def classes(self) -> np.ndarray: ...

    @property
    def cases(self) -> dict[int, int | None]: ...

    @property
    def names(self) -> tuple[str, ...]: ...

    def ratio(self, name: str) -> np.ndarray: ...

    def is_class(self, *names: str) -> np.ndarray: ...


def class_counts(judgement: ClassifiedPixels, hit: np.ndarray) -> dict[str, int]:
    """Hit pixels of each class; one that fails counts, whether anybody hit there or not."""
    counted = hit | judgement.is_class(*FAILING)
    numbers = np.bincount(judgement.classes[counted], minlength=len(CLASSES))
    return dict(zip(CLASSES, map(int, numbers), strict=True))


def largest_ratios(judgement: ClassifiedPixels) -> dict[str, float]:
    """The largest ratio of each check among the pixels that agree."""
    agreeing = judgement.classes == CLASS_CODE[AGREE]
    return {name: float(judgement.ratio(name)[agreeing].max(initial=0.0)) for name in judgement.names}


def defect_counts(judgement: ClassifiedPixels) -> dict[str, int]:
    """How many pixels where the reference is wrong are of which known case."""
    numbers = sorted(judgement.cases.values(), key=lambda case: (case is None, case))
    return dict(Counter(UNLISTED if case is None else str(case) for case in numbers))


def scene_statistics(scene: Scene) -> SceneStatistics:
    """Camera, shapes and number of primitives; the latter of a scene that can be packed."""
    count = 0
    with suppress(SceneError):
        count = int(packed(scene).first[-1])
    shapes = dict(Counter(str(shape.type) for shape in scene.shapes))
    return SceneStatistics(str(scene.camera.type), shapes, count)

"""What the page is told where our own caster was judged."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from caster.geometry.packing import Packed
from caster.rendering.images import Aovs
from caster.scene.model import Scene
from mitsuba_ref.error_model.bounds import PixelPairs, aov_rows, error_over_bound, row_distance
from mitsuba_ref.judge.checks import CHECKS
from mitsuba_ref.judge.classification import Judge, Judgement
from mitsuba_ref.judge.explanations import CONSTANT_REASONS, reason
from mitsuba_ref.report.html.evidence import LayerBound

# A share that is worked out twice, by a square root of a square here and without there, is the same up to 4 roundings.
ROUNDING = 1.0 + 4 * 2.0**-53
CHECK = {check.NAME: check for check in CHECKS}


@dataclass(frozen=True)
class EvidenceOfOurs:
    """mitsuba_ref.report.html.evidence.Evidence of a judge of ours."""

    judge: Judge
    judgement: Judgement

    @property
    def scene(self) -> Scene:
        return self.judge.scene

    @property
    def packed(self) -> Packed:
        return self.judge.model.packed

    @property
    def ours(self) -> Aovs:
        return self.judge.pair.ours

    @property
    def reference(self) -> Aovs:
        return self.judge.pair.reference

    @property
    def always(self) -> Mapping[str, str]:
        return CONSTANT_REASONS

    def why(self, row: int) -> str:
        return reason(self.judge, self.judgement, row)

    def bound(self, name: str) -> LayerBound:
        """`diffuse` has no one bound."""
        check, pixels = CHECK.get(name), self._pixels
        if check is None:
            return LayerBound()
        bound, ratio = check.bound(pixels), self.judgement.ratio(name)
        sides = (aov.reshape(len(ratio), -1) for aov in pixels.pair(name))
        alone = pixels.both_hit & (ratio > error_over_bound(row_distance(*sides), bound) * ROUNDING)
        return LayerBound(np.where(pixels.both_hit, bound, 0.0), alone)

    def ids(self) -> Mapping[str, np.ndarray]:
        pair, number = self.judge.pair, self.packed.index_in_shape
        theirs = np.where(pair.reference.hit.ravel(), pair.witness.answer.prim.astype(np.int64), -1)
        return {
            "shape_reference": aov_rows(pair.reference, "shape_id"),
            "shape_ours": aov_rows(pair.ours, "shape_id"),
            "prim_reference": theirs,
            "prim_ours": number(pair.prim),
        }

    def t(self) -> None:
        return None

    @cached_property
    def _pixels(self) -> PixelPairs:
        judge, pair = self.judge, self.judge.pair
        return PixelPairs(pair.ours, pair.reference, judge.bounds, pair.t, pair.length, judge.point)

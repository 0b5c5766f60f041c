"""Ours and the reference's pictures -> a Comparison: numbers, no opinion."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from caster.scene import Check
from mitsuba_ref.checks import CHECKS
from mitsuba_ref.pixels import Pixels


@dataclass(frozen=True)
class Comparison:
    """Error over bound by check, (n,) each; 1 is as much as the bound allows, inf what no bound covers."""

    ratios: Mapping[str, np.ndarray]
    pixels: Pixels

    @property
    def worst(self) -> np.ndarray:
        """(n,) the largest ratio of each pixel."""
        return np.max(list(self.ratios.values()), axis=0)


def compare(pixels: Pixels, allowed: Mapping[str, Check]) -> Comparison:
    """All checks; a scene's own [check.AOV] makes a bound stricter or laxer by its ratio."""
    ratios = {}
    for check in CHECKS:
        share = allowed[check.NAME].ratio if check.NAME in allowed else 1.0
        ratios[check.NAME] = check.ratio(pixels) / share
    return Comparison(ratios, pixels)

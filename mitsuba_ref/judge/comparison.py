"""Ours and the reference's pictures -> a Comparison: numbers, no opinion."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from caster.description.errors import SceneError
from caster.scene.model import Check
from mitsuba_ref.error_model.bounds import PixelPairs
from mitsuba_ref.judge.checks import CHECKS

# The quantities with a bound that a scene's own [check.AOV] may make stricter or laxer; the others are exact.
BOUNDED_AOVS = ("depth", "position", "normal", "shading_normal", "diffuse")


@dataclass(frozen=True)
class Comparison:
    """Error over bound by check, (n,) each; 1 is as much as the bound allows, inf what no bound covers."""

    ratios: Mapping[str, np.ndarray]
    allowed: Mapping[str, float]  # how much of the bound each may use; 1 unless the scene says otherwise

    @property
    def agrees(self) -> np.ndarray:
        """(n,) bool: no check finds more than it allows."""
        return np.all([ratio <= self.allowed[name] for name, ratio in self.ratios.items()], axis=0)

    @property
    def derived(self) -> np.ndarray:
        """(n,) bool: no check finds more than its derived bound."""
        return np.all([ratio <= 1.0 for ratio in self.ratios.values()], axis=0)


def compare(pixels: PixelPairs, checks: Mapping[str, Check]) -> Comparison:
    """All checks. checks: the scene's own [check.AOV]."""
    ratios = {check.NAME: check.ratio(pixels) for check in CHECKS}
    return Comparison(
        ratios, {name: checks[name].ratio if name in checks else 1.0 for name in (*ratios, "diffuse")}
    )


def check_allowances(checks: Mapping[str, Check]) -> None:
    """Raise SceneError for a [check.AOV] that nothing would heed."""
    for name in checks:
        if name not in BOUNDED_AOVS:
            raise SceneError(
                f"check.{name}: is compared exactly or not at all; there are bounds of {', '.join(BOUNDED_AOVS)}"
            )

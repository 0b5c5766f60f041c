"""The checks that the parameters of computed meshes share."""

import math

from caster.description.errors import SceneError


def check_integer(shape: str, name: str, value: int, low: int, high: float = math.inf) -> None:
    """Refuse anything but a whole number from `low` to `high`; the upper limits keep meshes within memory."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        limits = f">= {low}" if high == math.inf else f"from {low} to {high}"
        raise SceneError(f"{shape}: {name} must be a whole number {limits}, got {value!r}")


def check_length(shape: str, name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise SceneError(f"{shape}: {name} must be a length > 0, got {value!r}")

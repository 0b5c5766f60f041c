"""That something is refused, in words that say what is wrong."""

from collections.abc import Callable
from typing import Any

from caster import SceneError


def refused(make: Callable[[], Any], *words: str) -> int:
    """1, if `make` raises an error of ours that says all the words; else an AssertionError."""
    try:
        made = make()
    except SceneError as error:
        missing = [word for word in words if word not in str(error)]
        assert not missing, f"expected {missing} in {error}"
        return 1
    raise AssertionError(f"expected a refusal with {words}, got {made!r}")

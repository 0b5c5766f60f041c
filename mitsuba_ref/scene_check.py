"""The outcome of what is checked once a scene."""

from typing import NamedTuple


class SceneCheck(NamedTuple):
    """The outcome of one of them."""

    name: str
    ratio: float  # largest error over its bound; inf where something is there that must not be, or is missing
    what: str  # where the largest is; says what was looked at if all is well

    @property
    def ok(self) -> bool:
        return self.ratio <= 1.0

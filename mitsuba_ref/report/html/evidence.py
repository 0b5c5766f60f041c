"""What a scene's verdict rests on, kept until somebody writes it down: what the page asks of whoever judged."""

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np

from caster.geometry.packing import Packed
from caster.rendering.images import Aovs
from caster.scene.model import Scene
from mitsuba_ref.judge.adjudication import Adjudication


class PixelFindings(Protocol):
    """What was found about each pixel: a Judgement of ours, or one of a candidate."""

    @property
    def classes(self) -> np.ndarray:
        """(n,) index into CLASSES; WRONG is said of whoever is judged."""

    @property
    def names(self) -> tuple[str, ...]:
        """The checks that were made of each pixel."""

    @property
    def exact(self) -> Adjudication:
        """What exact arithmetic said."""

    @property
    def cases(self) -> dict[int, int | None]:
        """Row where the reference is wrong -> number of the known case."""

    def ratio(self, name: str) -> np.ndarray:
        """(n,) error over bound of a check."""

    def is_class(self, *names: str) -> np.ndarray:
        """(n,) bool."""


class LayerBound(NamedTuple):
    """What one layer is held to, one row a pixel."""

    between: np.ndarray | None = None  # (n,) of the difference between both sides
    alone: np.ndarray | None = (
        None  # (n,) bool: not that one counts, but that of our own arithmetic at our own surface
    )
    own: np.ndarray | None = None  # (n,) of a candidate's arithmetic, from the surface as float64 has it


class Evidence(Protocol):
    """Both pictures and what was found about each of their pixels: some 60 MB for 256 x 256 pixels.

    `ours` is whoever was judged: a candidate, where one stands in the place of ours.
    """

    @property
    def scene(self) -> Scene:
        """As it was judged."""

    @property
    def packed(self) -> Packed:
        """Its primitives."""

    @property
    def ours(self) -> Aovs:
        """The AOVs that are given, and no others."""

    @property
    def reference(self) -> Aovs:
        """Mitsuba's, at least of the same names."""

    @property
    def judgement(self) -> PixelFindings:
        """Of each pixel."""

    @property
    def always(self) -> Mapping[str, str]:
        """Class -> why a pixel has it, where that is the same for all of them."""

    def why(self, row: int) -> str:
        """Why one row of the picture has its class."""

    def bound(self, name: str) -> LayerBound:
        """What an AOV is held to."""

    def ids(self) -> Mapping[str, np.ndarray]:
        """`shape_reference`, `prim_reference`: (n,) shape, and primitive within it, -1 on a miss; and of ours, where
        that is given, `shape_ours`, `prim_ours`."""

    def t(self) -> tuple[np.ndarray, np.ndarray] | None:
        """(n,) ours and the reference's, in lengths of d; None where depth says it all."""

"""What a PLY element holds once read, whatever it was encoded in."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Column = NDArray[Any]  # one value a row


class Lists(NamedTuple):
    """A list property: how many values each row has, and all values in one array."""

    sizes: NDArray[np.int64]
    values: Column


Columns = dict[str, Column | Lists]


class Table(NamedTuple):
    """The columns of an element by name; the line of each row, where the encoding has lines."""

    columns: Columns
    lines: Sequence[int] | None

    def place(self, where: str, row: int) -> str:
        """Where a row is, for an error message."""
        return where if self.lines is None else f"{where}:{self.lines[row]}"

"""Several pictures as one: side by side, or in rows, each with its name below."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from caster.pictures.files import PAPER, label
from caster.pictures.views import Picture

Array = np.ndarray[Any, np.dtype[Any]]

GAP = 4  # pixels of paper between pictures
LABEL = 18  # pixels: height of a label


def strip(pictures: Sequence[Picture]) -> Array:
    """One picture as it is; several side by side, labelled. (h, w, 3) bytes."""
    return pictures[0].pixels if len(pictures) == 1 else sheet(pictures, len(pictures))


def sheet(pictures: Sequence[Picture], columns: int) -> Array:
    """Pictures in rows of so many, each in the middle of its cell, its name below it."""
    height = max(each.pixels.shape[0] for each in pictures)
    width = max(each.pixels.shape[1] for each in pictures)
    cells = [_cell(each, height, width) for each in pictures]
    rows = [cells[i : i + columns] for i in range(0, len(cells), columns)]
    blank = paper(height + LABEL, width)
    rows[-1] += [blank] * (min(columns, len(cells)) - len(rows[-1]))
    return _joined([_joined(row, axis=1) for row in rows], axis=0)


def paper(height: int, width: int) -> Array:
    return np.full((height, width, 3), PAPER, np.uint8)


def _cell(picture: Picture, height: int, width: int) -> Array:
    cell = paper(height + LABEL, width)
    h, w, _ = picture.pixels.shape
    y, x = (height - h) // 2, (width - w) // 2
    cell[y : y + h, x : x + w] = picture.pixels
    cell[height:] = label(picture.name, width, LABEL)
    return cell


def _joined(parts: Sequence[Array], axis: int) -> Array:
    """With gaps between them."""
    if len(parts) == 1:
        return parts[0]
    shape = list(parts[0].shape)
    shape[axis] = GAP
    gap = np.full(shape, PAPER[0], np.uint8)
    return np.concatenate([piece for part in parts for piece in (part, gap)][:-1], axis=axis)

"""Work shared by threads loses or repeats no primitive, for any number of threads.

A primitive that is in no tile or no leaf is invisible, and seldom is it one that a pixel shows. So for several numbers
of threads, most of which divide no number of primitives, each has to be in every tile of the film that its bounds
reach into, once, and in one leaf of a tree. Threads share few primitives only here.
"""

from collections.abc import Iterator

import numpy as np
import pytest

from caster.cameras import Pinhole
from caster.geometry.packing import packed
from caster.kernels.bvh.build import EMPTY_LINK, LEAF_SIZE_BASE, Tree
from caster.kernels.raster.screen_bounds import Window
from caster.kernels.raster.tile import HEIGHT, WIDTH
from caster.rendering import bvh_construction, rasterization
from caster.rendering.bvh_construction import build_tree
from caster.rendering.images import film_window
from caster.rendering.rasterization import BinnedKind, bin_kinds
from caster.scene.model import Scene

THREADS = (1, 2, 3, 5, 7)


def wrong_tiles(found: BinnedKind, expected: np.ndarray, window: Window, threads: int) -> Iterator[str]:
    """Primitives that are not in all tiles that they reach into, once each.

    expected: (n, 4) pixels x0, y0, x1, y1 of the bounds, by one thread.
    """
    pixels, count, words = found.bounds.pixels, len(expected), f"{threads} threads"
    different = (pixels != expected).any(axis=1)
    if different.any():
        yield f"{words} bound primitive {int(np.argmax(different))} of {count} otherwise than one does"
        return
    x0, y0, x1, y1 = pixels.T.astype(np.int64)
    on_film = (x0 < x1) & (y0 < y1)
    first, last = (x0 // WIDTH, y0 // HEIGHT), ((x1 - 1) // WIDTH, (y1 - 1) // HEIGHT)
    reached = np.where(on_film, (last[0] - first[0] + 1) * (last[1] - first[1] + 1), 0)
    prim, tile = found.order.astype(np.int64), np.repeat(np.arange(len(found.runs) - 1), np.diff(found.runs))
    if len(prim) != len(tile) or ((prim < 0) | (prim >= count)).any():
        yield f"{words} put {len(prim)} primitives into tiles that have {len(tile)}"
        return
    row, column = np.divmod(tile, len(range(0, window.width, WIDTH)))
    inside = (first[0][prim] <= column) & (column <= last[0][prim]) & (first[1][prim] <= row) & (row <= last[1][prim])
    pairs = np.unique(np.stack([tile, prim])[:, inside & on_film[prim]], axis=1)
    times = np.bincount(pairs[1], minlength=count)
    wrong = (times != reached) | (np.bincount(prim, minlength=count) != reached)
    if wrong.any():
        place = int(np.argmax(wrong))
        yield f"{words} put primitive {place} of {count} into {times[place]} of the {reached[place]} tiles it reaches"


def wrong_leaves(tree: Tree, count: int, words: str) -> Iterator[str]:
    """Primitives that are not in one leaf of a tree, and nodes that are not below one other."""
    links = tree.links.ravel()
    start, number = np.divmod(~links[(links < 0) & (links != EMPTY_LINK)].astype(np.int64), LEAF_SIZE_BASE)
    within = np.arange(number.sum()) - np.repeat(np.cumsum(number) - number, number)
    places = np.repeat(start, number) + within
    if not np.array_equal(np.sort(links[links > 0]), np.arange(1, len(tree.links))):
        yield f"{words}: not every node is below one other"
    if (places >= len(tree.order)).any():
        yield f"{words}: a leaf has primitives beyond the last"
        return
    times = np.bincount(tree.order[places], minlength=count)
    if len(times) != count or (times != 1).any():
        place = int(np.argmax(times != 1))
        yield f"{words} has primitive {place} of {count} in {times[place]} leaves"


@pytest.fixture
def scene(monkeypatch) -> Scene:
    """320 triangles over several tiles, of which some are off the film."""
    monkeypatch.setattr(rasterization, "PARALLEL_MIN_PRIMITIVES", 16)
    monkeypatch.setattr(rasterization, "unwritten_array", lambda shape, dtype: np.full(shape, -1, dtype))
    monkeypatch.setattr(bvh_construction, "PARALLEL_MIN_PRIMITIVES", 64)
    camera = Pinhole(eye=(0.3, 0.2, 2.1), look_at=(0.4, 0.0, 0.0), up=(0.0, 1.0, 0.0))
    found = Scene(camera=camera, shapes=[{"type": "icosphere", "subdivisions": 2}])
    return found.with_film(width=300, height=70)


def binned(scene: Scene, number: int) -> BinnedKind:
    """The triangles of the scene in tiles, by so many threads."""
    (found,) = bin_kinds(packed(scene), scene.camera.pack(300, 70), film_window(scene), 2.1, threads=number)
    assert len(found.runs) > 3 and 0 < found.on_film.sum() < 320
    return found


def test_each_primitive_is_once_in_each_tile_it_reaches(scene, monkeypatch):
    """Each thread writes its own part of the result, in any order."""

    def backwards(begin, pieces, workers):
        for piece in reversed(pieces):
            begin()(piece)

    expected = binned(scene, 1)
    for number in THREADS:
        for order in (None, backwards):
            with monkeypatch.context() as patch:
                if order is not None:
                    patch.setattr(rasterization, "parallel_for_pieces", order)
                found = binned(scene, number)
            said = "; ".join(wrong_tiles(found, expected.bounds.pixels, film_window(scene), number))
            assert said == "", said
            assert np.array_equal(found.order, expected.order) and np.array_equal(found.runs, expected.runs)


def test_each_primitive_is_in_one_leaf(scene):
    boxes = packed(scene).kinds[0].boxes()
    trees = {number: build_tree(*boxes, number) for number in THREADS}
    for number, tree in trees.items():
        said = "; ".join(wrong_leaves(tree, 320, f"the tree of {number} threads"))
        assert said == "", said
        assert all(map(np.array_equal, tree, trees[1])), f"the tree of {number} threads is another one"

"""Memory of images and workspaces is reused, but never by two at the same time."""

import gc
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from caster import Film, Icosphere, Pinhole, Point, Scene, Sphere
from caster.rendering import shading, threads
from caster.rendering.images import render

EVERY_IMAGE = ("depth", "normal", "position", "diffuse")


@pytest.fixture
def no_spare_memory(monkeypatch):
    monkeypatch.setattr(threads, "_SPARE_BLOCKS", {})


def a_large_scene() -> Scene:
    camera = Pinhole(eye=(0.0, 0.0, 4.0), look_at=(0.0, 0.0, 0.0))
    light = Point(position=(2.0, 3.0, 4.0), intensity=(9.0, 9.0, 9.0))
    film = Film(width=256, height=192)
    return Scene(film=film, camera=camera, shapes=[Icosphere(subdivisions=4)], lights=[light])


def addresses(images) -> list[int]:
    return sorted(images[name].ctypes.data for name in images)


def test_memory_of_released_images_is_written_again(no_spare_memory):
    first = render(a_large_scene(), EVERY_IMAGE)
    expected = {name: first[name].copy() for name in first}
    where = addresses(first)
    gc.disable()
    try:
        del first  # without a collector's help: no circle of references holds an image
        assert len(threads._SPARE_BLOCKS) > len(EVERY_IMAGE)  # with workspaces of the tiles
        for block in threads._SPARE_BLOCKS.values():
            block[:] = 0xA5  # nothing of it is read before it is written
        again = render(a_large_scene(), EVERY_IMAGE)
    finally:
        gc.enable()
    assert addresses(again) == where
    assert all(np.array_equal(expected[name], again[name]) for name in EVERY_IMAGE)


def test_a_view_keeps_the_memory_of_its_image(no_spare_memory):
    images = render(a_large_scene(), ("position",))
    view, expected = images["position"][60:80, ::2, 1], images["position"][60:80, ::2, 1].copy()
    del images
    assert view.base.nbytes not in {block.nbytes for block in threads._SPARE_BLOCKS.values()}
    others = [render(a_large_scene(), ("position",)) for _ in range(3)]
    others[0]["position"][:] = 7.0
    assert np.array_equal(view, expected)


def test_no_more_memory_than_a_limit_is_kept(no_spare_memory, monkeypatch):
    monkeypatch.setattr(threads, "MAX_SPARE_BYTES", 4 * 256 * 192 * 24)
    for height in (192, 191, 190, 189):
        render(a_large_scene().with_film(width=256, height=height), ("position",))
    kept = [block.nbytes for block in threads._SPARE_BLOCKS.values()]
    assert sum(kept) <= threads.MAX_SPARE_BYTES
    assert 256 * 189 * 24 in kept and 256 * 192 * 24 not in kept  # the newest image, not the oldest


def test_large_images_at_the_same_time_have_memory_of_their_own(no_spare_memory):
    expected = render(a_large_scene(), ("position",))["position"].copy()
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: render(a_large_scene(), ("position",), threads=1)["position"], range(24)))
    assert all(np.array_equal(each, expected) for each in found)
    assert len({each.ctypes.data for each in found}) == 24


def test_a_kind_that_no_tile_has_is_not_looked_for(monkeypatch):
    """Normals and surfaces of a kind are computed only in tiles where some primitive of it may be seen."""
    scene = Scene(
        film=Film(width=512, height=64),
        camera=Pinhole(eye=(0.0, 0.0, 4.0), look_at=(0.0, 0.0, 0.0)),
        shapes=[Icosphere(subdivisions=3, to_world=[{"translate": (-1.0, 0.0, 0.0)}, {"scale": 0.2}]), Sphere()],
    )
    for aovs in (("normal",), ("shading_normal",), ("shading_normal", "uv")):
        kinds, original = [], shading.surfaces_in_tile

        def counted(*args, kinds=kinds, original=original):
            kinds.extend(type(arg).__name__ for arg in args if type(arg).__name__ == "Triangles")
            return original(*args)

        monkeypatch.setattr(shading, "surfaces_in_tile", counted)
        render(scene, aovs, threads=1)
        assert len(kinds) == 1, aovs  # of four tiles
        monkeypatch.undo()

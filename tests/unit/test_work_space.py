"""What a picture has worked in is there for the next one, and for no other at the same time."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from caster import Film, Icosphere, Pinhole, Scene
from caster.rendering import rasterization
from caster.rendering.hits import packed
from caster.rendering.images import render


def a_scene() -> Scene:
    camera = Pinhole(eye=(0.0, 0.0, 4.0), look_at=(0.0, 0.0, 0.0))
    return Scene(film=Film(width=150, height=70), camera=camera, shapes=[Icosphere(subdivisions=4)])


def test_the_next_picture_uses_it_and_has_the_same_bits():
    scene = a_scene()
    first = render(scene, ("depth", "normal"))
    (kind,) = packed(scene).kinds
    (space,) = kind.spare
    for array in space:
        array[...] = -1  # nothing of it is read before it is written
    again = render(scene, ("depth", "normal"))
    assert [id(a) for a in kind.spare[0]] == [id(a) for a in space]
    assert all(np.array_equal(first[name], again[name]) for name in ("depth", "normal"))


def test_pictures_at_the_same_time_have_their_own():
    scene = a_scene()
    expected = render(scene, ("depth",))["depth"]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: render(scene, ("depth",), threads=1)["depth"], range(24)))
    assert all(np.array_equal(each, expected) for each in found)
    assert len(packed(scene).kinds[0].spare) == 1


def test_what_is_too_large_is_not_kept(monkeypatch):
    scene = a_scene()
    monkeypatch.setattr(rasterization, "MAX_KEPT_WORKSPACE", 0)
    render(scene, ("depth",))
    assert packed(scene).kinds[0].spare == []

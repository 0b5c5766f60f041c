"""Every public route to a pixel gives the bits of the whole image: AOVs, threads, dtypes, crops, cast, occluded."""

from itertools import cycle

import numpy as np
import pytest
from same_bits import assert_same_bits

from caster.aovs import BY_NAME
from caster.rendering.hits import cast, occluded
from caster.rendering.images import camera_rays, evaluate, film_window, render, trace_film
from caster.scene.files import load_scene

SCENES = ("one-sphere", "inside-sphere", "cornell-box", "shared-edges-cube", "lights-and-shadows")
SIDE = 15  # pixels; an odd number, so that the middle of an edge is a pixel's centre
WIDE = (129, 2)  # one pixel wider than a tile
ALL = tuple(BY_NAME)
SETS = [*((name,) for name in ALL), ("depth", "normal"), ("uv", "depth"), ("diffuse", "prim_id")]
CROPS = [(0, 0, SIDE, SIDE), (3, 4, 9, 11), (7, 7, 8, 8)]


def small(name, width=SIDE, height=SIDE):
    return load_scene(f"scenes/{name}.toml").with_film(width=width, height=height)


@pytest.mark.parametrize("name", SCENES)
def test_each_set_of_aovs_gives_the_bits_of_all_together(name):
    for film in (small(name), small(name, *WIDE)):
        whole = render(film, ALL, threads=1)
        for names, threads in zip(SETS, cycle((3, 2, 1)), strict=False):
            expected = {each: whole[each] for each in names}
            assert_same_bits(expected, render(film, names, threads=threads), f"{names}, {threads} threads")


@pytest.mark.parametrize("name", SCENES)
def test_a_crop_and_float32_are_the_whole_image_cut_and_rounded(name):
    scene = small(name)
    whole = render(scene, ALL, threads=1)
    for x0, y0, x1, y1 in CROPS:
        part = scene.with_film(crop=(x0, y0, x1, y1))
        cut = {each: whole[each][y0:y1, x0:x1] for each in ALL}
        rounded = {each: a.astype(np.float32) if a.dtype.kind == "f" else a for each, a in cut.items()}
        assert_same_bits(cut, render(part, ALL), "crop")
        assert_same_bits(rounded, render(part, ALL, dtype=np.float32), "float32")
        assert_same_bits(cut, evaluate(trace_film(part, threads=1), ALL, film_window(part)), "rays of a crop")


@pytest.mark.parametrize("name", SCENES)
def test_rays_cast_one_by_one_hit_what_the_image_shows(name):
    scene = small(name)
    whole, rays = render(scene, ALL), camera_rays(scene)
    expected = {each: whole[each].reshape(SIDE * SIDE, *whole[each].shape[2:]) for each in ALL}
    normal = cast(scene, rays.o, rays.d).normal  # of a call of its own, since it may be found without the others
    assert_same_bits({"normal": expected["normal"]}, {"normal": normal}, "cast(...).normal")
    hits = cast(scene, rays.o, rays.d)
    surface, d = hits.surface, rays.d
    found = {
        "depth": hits.t * np.sqrt(d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1] + d[:, 2] * d[:, 2]),
        "shape_id": hits.shape_id,
        "prim_id": hits.prim_id,
        "normal": surface.n,
        "shading_normal": surface.sh_n,
        "position": surface.p,
        "uv": surface.uv,
    }
    assert_same_bits({each: expected[each] for each in found}, found, "cast")


@pytest.mark.parametrize("name", SCENES)
def test_limits_before_at_and_beyond_a_hit(name):
    """Of all rays alike, and of each ray its own; `occluded` answers whether `cast` hits."""
    scene = small(name)
    o, d = camera_rays(scene)[:2]
    first = cast(scene, o, d).t
    t = float(np.sort(first[np.isfinite(first)])[np.isfinite(first).sum() // 2])
    limits = [(0.0, np.inf), (0.0, t), (0.0, np.nextafter(t, 0.0)), (t, np.inf), (0.9 * t, 1.1 * t)]
    alone = [cast(scene, o, d, t_min=low, t_max=high).t for low, high in limits]
    for (low, high), each in zip(limits, alone, strict=True):
        blocked = occluded(scene, o, d, high, t_min=low)
        assert_same_bits({"t": np.isfinite(each)}, {"t": blocked}, f"occluded, t_min {low!r}, t_max {high!r}")
    low, high = (np.resize(column, len(o)) for column in np.array(limits).T)
    expected = np.choose(np.arange(len(o)) % len(limits), alone)
    found = cast(scene, o, d, t_min=low, t_max=high).t
    assert_same_bits({"t": expected}, {"t": found}, "t_min and t_max of each ray")
    assert_same_bits({"t": np.isfinite(expected)}, {"t": occluded(scene, o, d, high, t_min=low)}, "occluded, each ray")

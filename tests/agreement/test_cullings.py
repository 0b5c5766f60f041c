"""All cullings give the same bits: brute force, rasterization and BVHs."""

import numpy as np
import pytest
from random_scenes import KINDS, VIEWS, in_each_view, name, random_scene
from same_bits import assert_same_bits

from caster.aovs import BY_NAME
from caster.cameras import Orthographic, Pinhole
from caster.geometry.packing import pack
from caster.rendering.images import render, render_film
from caster.scene.model import Scene
from caster.shapes import SHAPES, Cube, Heightfield, Icosphere, Sphere

SIZES = (1e-3, 1.0, 1e3)
FARTHEST = 1e3  # how many of its sizes a scene stands away from the origin, at most


CULLINGS = ("raster", "bvh")  # compared with brute force


def count_hits_where_cullings_agree(scene: Scene) -> tuple[int, int]:
    """(number of hits, of rays); fails if a culling changes a bit of any AOV."""
    expected = render(scene, tuple(BY_NAME), culling="brute-force")
    for culling in CULLINGS:
        assert_same_bits(expected, render(scene, tuple(BY_NAME), culling=culling), culling)
    return int(expected.hit.sum()), expected.hit.size


@in_each_view
@pytest.mark.parametrize("shape", KINDS, ids=name)
@pytest.mark.slow("every kind before every camera", every=2)
def test_culling_never_changes_a_bit(shape, camera):
    rng = np.random.default_rng([1, SHAPES.index(shape), VIEWS.index(camera)])
    counts = []
    for size in SIZES:
        for offset in (0.0, FARTHEST * size):
            scene = random_scene(rng, [shape], camera, size=size, offset=offset)
            counts.append(count_hits_where_cullings_agree(scene))
    hits, rays = np.sum(counts, axis=0)
    misses = rays - hits if all(kind.bounded for kind in pack(scene).kinds) else np.inf
    assert hits >= 100 and misses >= 100, f"{hits} hits of {rays} rays prove little"


@in_each_view
def test_culling_never_changes_a_bit_where_all_kinds_are_mixed(camera):
    rng = np.random.default_rng([2, VIEWS.index(camera)])
    kinds = set()
    for size in SIZES:
        scene = random_scene(rng, SHAPES, camera, count=3, size=size, offset=size)
        assert count_hits_where_cullings_agree(scene)[0] >= 100
        kinds |= set(np.unique(render(scene, ("shape_id",))["shape_id"]) % len(SHAPES))
    assert len(kinds) >= len(SHAPES) // 2, f"only {len(kinds)} kinds are seen"


@in_each_view
def test_a_crop_is_that_part_of_the_whole_image_in_every_culling(camera):
    rng = np.random.default_rng([4, VIEWS.index(camera)])
    scene = random_scene(rng, SHAPES, camera, count=2)
    x0, y0, x1, y1 = crop = (11, 5, 30, 21)
    whole = render(scene, tuple(BY_NAME))
    part = scene.with_film(crop=crop)
    for culling in ("brute-force", *CULLINGS):
        expected = {aov: image[y0:y1, x0:x1] for aov, image in whole.items()}
        assert_same_bits(expected, render(part, tuple(BY_NAME), culling=culling), f"crop, {culling}")
    assert part.film.window == crop and whole.hit[y0:y1, x0:x1].sum() >= 50


def test_every_culling_gives_numbers_of_the_type_that_is_requested():
    """Numbers are rounded once, at the end; ids are unchanged."""
    scene, names = random_scene(np.random.default_rng(6), [Sphere], Pinhole), ("depth", "normal", "shape_id")
    images = render(scene, names)
    expected = {name: images[name].astype(np.float32) for name in names[:2]} | {"shape_id": images["shape_id"]}
    for culling in ("brute-force", *CULLINGS):
        found = render(scene, names, culling=culling, dtype=np.float32)
        assert_same_bits(expected, found, f"float32, {culling}")


@pytest.mark.parametrize("camera", [Pinhole, Orthographic], ids=name)
@pytest.mark.parametrize("size", [1e-300, 1e-160, 1e100, 1e154, 1e200, 1e300])
@pytest.mark.slow("each size before both cameras", every=2)
def test_sizes_that_have_no_squares_change_nothing(size, camera):
    """Spheres and triangles that overlap, off centre and partly off the film."""
    across = {"width": 4.0 * size} if camera is Orthographic else {}
    for aside in (0.0, 0.5, 1.9, -1.9):
        ball = Sphere(center=(aside * size, 0.0, 0.0), radius=0.5 * size)
        far = Sphere(center=(0.0, 0.0, -size), radius=0.7 * size)
        cube = Cube(to_world=[{"scale": 0.3 * size}, {"translate": (-aside * size, 0.1 * size, size)}])
        looking = camera(eye=(0.0, 0.0, 5.0 * size), look_at=(0.0, 0.0, 0.0), **across)
        for shapes in ([ball, far], [ball, far, cube]):
            scene = Scene(film={"width": 16, "height": 12}, camera=looking, shapes=shapes)
            every = render(scene, ("depth", "normal"), culling="brute-force")
            assert_same_bits(every, render(scene, ("depth", "normal"), culling="raster"), "at once")
            hits, _ = count_hits_where_cullings_agree(scene)
            assert hits >= 9


FILM = {"width": 32, "height": 24}


@pytest.mark.parametrize(
    ("shape", "camera"),
    [
        (Icosphere(subdivisions=5), Pinhole(eye=(0.0, 0.0, 4.0), look_at=(0.0, 0.0, 0.0), fov=40.0)),
        # Every centre of a pixel is a corner of six triangles, or very near to one.
        *(
            (
                Heightfield(size=2.0, resolution=64, amplitude=0.2, to_world=[{"translate": (aside, 0.0, 0.0)}]),
                Orthographic(eye=(0.0, 0.0, 5.0), direction=(0.0, 0.0, -1.0), up=(0.0, 1.0, 0.0), width=2.0),
            )
            for aside in (0.0, 2.0**-50, -(2.0**-50), 1e-4, 2.0**-10 / 16.0)
        ),
    ],
    ids=["ball", "at corners", "right of them", "left of them", "a little aside", "aside by the margin"],
)
def test_triangles_between_pixel_centres_are_dropped_and_no_others(shape, camera):
    scene = Scene(film=FILM, camera=camera, shapes=[shape])
    assert count_hits_where_cullings_agree(scene)[0] >= 200
    rendered = render_film(scene, ("depth",), culling="raster")
    tried, there = rendered.on_film[0].sum(), len(rendered.packed.kinds[0].ids)
    assert FILM["width"] < tried < 0.8 * there, f"{tried} of {there} triangles are tried"

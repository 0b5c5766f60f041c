"""Shadows by fans are those of brute force."""

import numpy as np
import pytest
from random_scenes import KINDS, name, random_scene

from caster.cameras import Pinhole
from caster.geometry.packing import packed
from caster.jit.simd import LANES
from caster.kernels.bvh.build import LEAF_SIZE
from caster.kernels.nearest import Rays
from caster.kernels.protocol import hull_point, hull_size
from caster.kernels.raster.tile import PIXELS, WIDTH, T, lane, load_rays, new_tile
from caster.kernels.surface.lighting import DirectionalLight, PointLight
from caster.rendering.casting import find_nearest
from caster.rendering.ray_tiles import TileCaster, TileWorkspace
from caster.rendering.shading import decide_shadows
from caster.shapes import SHAPES, Cube

ROWS = 8
COUNT = ROWS * WIDTH
RUN = 8  # rays that a fan takes or leaves together
WHITE = (1.0, 1.0, 1.0)


def hull_points(arrays, rng, count):
    """Points of hulls of random primitives, such as vertices; of planes, which have none, anything."""
    points = rng.normal(size=(count, 3))
    for i in range(count):
        kind = arrays.kinds[rng.integers(len(arrays.kinds))]
        corners = hull_size(kind.prims)
        if corners and kind.bounded:
            points[i] = hull_point(kind.prims, int(rng.integers(len(kind.ids))), int(rng.integers(corners)))
    return points


def shadow_rays(light, arrays, rng, size):
    """Rays to a light, RUN neighbours from about one place: behind a hull point by much, little or nothing, or any."""
    runs = COUNT // RUN
    through = np.where(rng.random((runs, 1)) < 0.8, hull_points(arrays, rng, runs), size * rng.normal(size=(runs, 3)))
    far = rng.choice([0.0, 1e-9, 0.1, 0.3, 1.0], (runs, 1))
    if isinstance(light, PointLight):
        origins = through + np.minimum(far, 1.0) * (through - np.array(light.position))
    else:
        origins = through - far * size * np.array(light.back)
    origins = np.where(rng.random((runs, 1)) < 0.05, 50.0 * origins, origins)  # beyond the reach of fans
    spread = size * rng.choice([0.0, 1e-15, 1e-9, 1e-3, 0.1], (runs, 1, 1))
    o = (origins[:, None] + spread * rng.normal(size=(runs, RUN, 3))).reshape(-1, 3)
    if isinstance(light, PointLight):
        d, reach = np.array(light.position) - o, np.ones(COUNT)
    else:
        d, reach = np.tile(light.back, (COUNT, 1)), np.full(COUNT, np.inf)
    none = (rng.random(COUNT) < 0.1) | ~(np.abs(d).max(axis=1) > 0.0)
    return Rays(
        np.where(none[:, None], 0.0, o),
        np.where(none[:, None], [0.0, 0.0, 1.0], d),
        np.where(none, 0.0, rng.choice([0.0, 1e-12], COUNT)),
        np.where(none, -1.0, reach),
    )


def tile_of(rays):
    tile = new_tile()
    load_rays(rays, np.append(np.arange(COUNT, dtype=np.int32), np.full(PIXELS - COUNT, -1, np.int32)), tile)
    return tile


def shadowed(caster, arrays, rays):
    """(n,) bool, by fans; uncertain ones exactly."""
    tile = tile_of(rays)
    caster.begin(tile, TileWorkspace().ray_groups)(COUNT)
    decide_shadows(arrays, tile, COUNT)
    field = int(lane(T))
    return tile[field : field + COUNT] < np.inf


def lights(arrays, rng, size):
    """Point lights around, among, far from and exactly at the shapes; directional ones, askew and along axes."""
    middle = hull_points(arrays, rng, 1)[0]
    places = [middle + size * rng.normal(size=3) for _ in range(2)]
    places += [middle + 4.0 * size * rng.normal(size=3), middle + 1e7 * size * rng.normal(size=3)]
    places += [hull_points(arrays, rng, 1)[0]]
    backs = [rng.normal(size=3), rng.normal(size=3) * [1.0, 1e-9, 1.0], [0.0, -1.0, 0.0]]
    yield from (PointLight(tuple(map(float, place)), WHITE) for place in places)
    for back in backs:
        back = np.array(back) / np.linalg.norm(back)
        yield DirectionalLight(tuple(map(float, back)), WHITE)


def assert_fans_change_no_shadow(arrays, rng, size):
    for light in lights(arrays, rng, size):
        caster, rays = TileCaster(arrays, any_hit=True, light=light, rays=COUNT), shadow_rays(light, arrays, rng, size)
        real = rays.t_max >= 0.0
        expected = find_nearest(arrays, rays, "brute-force", 1).prim >= 0
        assert not ((expected != shadowed(caster, arrays, rays)) & real).any(), light


@pytest.mark.parametrize("size", [1.0, 1e-6, 1e5])
@pytest.mark.parametrize("shape", KINDS, ids=name)
@pytest.mark.slow("three sizes of each kind", every=3)
def test_fans_never_change_a_shadow(shape, size):
    rng = np.random.default_rng([90, list(SHAPES).index(shape), int(np.log10(size)) + 9])
    offset = float(rng.choice([0.0, 30.0])) * size
    scene = random_scene(rng, [shape], Pinhole, count=LEAF_SIZE + 3, size=size, offset=offset)
    assert_fans_change_no_shadow(packed(scene), rng, size)


def test_fans_never_change_a_shadow_where_all_kinds_are_mixed():
    rng = np.random.default_rng(91)
    arrays = packed(random_scene(rng, list(SHAPES), Pinhole, count=LEAF_SIZE + 1))
    assert len(arrays.prim_ids) > 100
    assert_fans_change_no_shadow(arrays, rng, 1.0)


@pytest.mark.parametrize("place", [(0.0, 0.1, 0.0), (9.0, 5.0, 2.0)])
def test_rays_of_any_direction_are_taken_by_some_fan(place):
    """Also around a light that stands among the shapes."""
    rng = np.random.default_rng(92)
    arrays, light = packed(random_scene(rng, [Cube], Pinhole, count=20)), PointLight(place, WHITE)
    caster, rays = TileCaster(arrays, any_hit=True, light=light, rays=COUNT), shadow_rays(light, arrays, rng, 1.0)
    groups = TileWorkspace().ray_groups
    caster.begin(tile_of(rays), groups)(COUNT)
    assert groups.taken[: COUNT // LANES].mean() > 0.8

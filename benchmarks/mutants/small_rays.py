"""tests/agreement on rays that plain Python casts in a second: trees and fans find what brute force finds."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "agreement"))
from hard_rays import hard_rays
from random_scenes import name, random_scene
from same_bits import assert_same_bits
from test_ray_fans import from_point, points
from test_shadow_fans import COUNT as SHADOW_RAYS
from test_shadow_fans import lights, shadow_rays, tile_of

from caster.cameras import Pinhole
from caster.geometry.packing import packed
from caster.jit.simd import LANES
from caster.kernels.bvh.build import LEAF_SIZE
from caster.kernels.nearest import Rays
from caster.kernels.raster.tile import WIDTH, T, lane
from caster.rendering import ray_fans
from caster.rendering.casting import find_any, find_nearest
from caster.rendering.hits import validated_rays
from caster.rendering.ray_fans import SAMPLED_RAYS, RayRows
from caster.rendering.ray_tiles import TileCaster, TileWorkspace
from caster.rendering.shading import decide_shadows
from caster.shapes import SHAPES

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
PAIRS = ("cube", "sphere"), ("triangle", "disk"), ("icosphere", "cylinder"), ("rectangle", "triangle")
LIGHTS = 8  # of `lights`
RAYS = 48 // LANES * LANES


def two_kinds(number):
    """Two kinds of primitives, each of enough for a tree, and random numbers for what is asked of them."""
    rng = np.random.default_rng([61, number])
    chosen = [cls for cls in SHAPES if name(cls) in PAIRS[number % len(PAIRS)]]
    return packed(random_scene(rng, chosen, Pinhole, count=LEAF_SIZE + 2)), rng


@pytest.fixture
def as_rows(monkeypatch):
    """Few rays from one point are cast as rows, too."""
    monkeypatch.setattr(ray_fans, "MIN_RAYS_IN_ROWS", SAMPLED_RAYS)
    monkeypatch.setattr(ray_fans, "MIN_SHARE_IN_VIEW", 0.0)
    monkeypatch.setattr(ray_fans, "PRIMITIVES_PER_RAY_IN_ROWS", 1e9)
    monkeypatch.setattr(ray_fans, "find_rows", lambda rays: RayRows(0, WIDTH, len(rays.o) // WIDTH))


@pytest.mark.parametrize(("place", "pair"), [(0, 3), (1, 1), (2, 3), (3, 1)])  # others have many faces
@pytest.mark.parametrize("elsewhere", [False, True])
def test_rays_of_one_point_find_as_fans_what_brute_force_finds(place, pair, elsewhere, as_rows):
    """Some of them, but for those that are sampled, come from elsewhere."""
    arrays, rng = two_kinds(pair)
    rays = from_point(list(points(arrays, rng, 1.0))[place], arrays, rng, 1.0)
    rays = Rays(*(a[:WIDTH] for a in rays))
    if elsewhere:
        strays = np.setdiff1d(np.arange(WIDTH), np.linspace(0, WIDTH - 1, SAMPLED_RAYS).astype(int))
        rays.o[strays] = rays.o[0] - 2.0 * rays.d[strays]
    slow = find_nearest(arrays, rays, "brute-force", 1)
    fast = find_nearest(arrays, rays, threads=1)
    assert_same_bits({"t": slow.t, "prim": slow.prim}, {"t": fast.t, "prim": fast.prim}, f"place {place}")


@pytest.mark.parametrize("number", range(LIGHTS * len(PAIRS)))
def test_fans_find_the_shadows_that_brute_force_finds(number):
    """And take most of the rays, before any is left to the tree."""
    arrays, rng = two_kinds(number)
    light = list(lights(None, arrays, rng, 1.0))[number // len(PAIRS)]
    all_rays = shadow_rays(light, arrays, rng, 1.0)
    runs = rng.permutation(SHADOW_RAYS // LANES)[: RAYS // LANES]
    kept = (runs[:, None] * LANES + np.arange(LANES)).ravel()
    kept = kept[all_rays.t_max[kept] >= 0.0]
    some = np.full(SHADOW_RAYS, -1.0)
    some[kept] = all_rays.t_max[kept]
    tile, groups = tile_of(all_rays._replace(t_max=some)), TileWorkspace().ray_groups
    TileCaster(arrays, any_hit=True, light=light, rays=SHADOW_RAYS).begin(tile, groups)(SHADOW_RAYS)
    decide_shadows(arrays, tile, SHADOW_RAYS)
    expected = find_nearest(arrays, Rays(*(a[kept] for a in all_rays)), "brute-force", 1).prim >= 0
    assert (tile[int(lane(T)) + kept] < np.inf).tolist() == expected.tolist()
    assert groups.taken[kept // LANES].mean() > 0.6


@pytest.mark.parametrize("number", range(2 * len(PAIRS)))
def test_trees_of_two_kinds_find_the_hits_that_brute_force_finds(number):
    arrays, rng = two_kinds(number)
    for family, (o, d) in hard_rays(arrays, rng, 5).items():
        for o_of, d_of in ((o, d), (np.repeat(o[:1], len(d), axis=0), d)):
            rays = validated_rays(o_of, d_of, 0.0, np.inf)
            slow, fast = (find_nearest(arrays, rays, culling, 1) for culling in ("brute-force", "bvh"))
            assert_same_bits(slow._asdict(), fast._asdict(), family)
            assert find_any(arrays, rays, 1).tolist() == (slow.prim >= 0).tolist()

"""The number of threads changes no bit."""

import numpy as np
from hard_rays import hard_rays
from random_scenes import VIEWS, in_each_view, random_scene
from same_bits import assert_same_bits

from caster.aovs import BY_NAME
from caster.cameras import Pinhole
from caster.rendering.casting import find_nearest
from caster.rendering.hits import packed, validated_rays
from caster.rendering.images import render
from caster.scene.model import Scene
from caster.shapes import SHAPES

THREADS = (2, 3, 7)


def count_hits_where_threads_agree(scene: Scene, culling: str | None = None) -> int:
    """Number of pixels that hit; fails if several threads change a bit of any AOV."""
    expected = render(scene, tuple(BY_NAME), threads=1, culling=culling)
    for threads in THREADS:
        got = render(scene, tuple(BY_NAME), threads=threads, culling=culling)
        assert_same_bits(expected, got, f"{threads} threads")
    return int(expected.hit.sum())


@in_each_view
def test_threads_never_change_a_bit(camera):
    rng = np.random.default_rng([20, VIEWS.index(camera)])
    for culling in (None, "bvh", "brute-force"):
        scene = random_scene(rng, SHAPES, camera, count=2)
        assert count_hits_where_threads_agree(scene, culling) >= 100


def test_threads_never_change_a_bit_of_any_ray():
    rng = np.random.default_rng(21)
    scene = random_scene(rng, SHAPES, Pinhole, count=3)
    for family, (o, d) in hard_rays(packed(scene), rng, 1000).items():
        rays = validated_rays(o, d, 0.0, np.inf)
        expected = find_nearest(packed(scene), rays, threads=1)
        for threads in THREADS:
            got = find_nearest(packed(scene), rays, threads=threads)
            assert_same_bits(expected._asdict(), got._asdict(), f"{family}, {threads} threads")
        assert (expected.prim >= 0).sum() >= 300

"""Mirrored rays in a mirrored scene: t and ids are equal to the bit, positions and normals mirrored.

Every sum of the kernels is one of squares or of products in which a mirror flips both signs or neither. A
mirrored mesh also turns its faces around: it swaps the second and third corner, so triangles add these first.

Left out are uv, which tell left from right on a plane and on untextured triangles, and the shading normals,
which a mesh without any has generated: from its edges, and those are other ones after the turn.
"""

import numpy as np
import pytest
from hard_rays import hard_rays
from random_scenes import name, random_scene
from same_bits import Arrays, assert_same_bits, without_signed_zeros

from caster.cameras import Pinhole
from caster.rendering.hits import cast, packed
from caster.scene.model import Scene
from caster.shapes import SHAPES

MIRRORS = ((-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, -1.0), (-1.0, -1.0, 1.0), (-1.0, -1.0, -1.0))


def mirrored_scene(scene: Scene, mirror: np.ndarray) -> Scene:
    shapes = [shape.model_copy(update={"to_world": (*shape.to_world, {"scale": mirror})}) for shape in scene.shapes]
    return scene.model_copy(update={"shapes": shapes})


def what_is_cast(scene: Scene, o: np.ndarray, d: np.ndarray, mirror: np.ndarray) -> Arrays:
    """The hits of mirrored rays, mirrored back."""
    hits = cast(scene, o * mirror, d * mirror)
    p, n = hits.position * mirror, hits.normal * mirror
    return without_signed_zeros({"t": hits.t, "shape": hits.shape_id, "prim": hits.prim_id, "p": p, "n": n})


def count_hits_where_mirrors_agree(scene: Scene, mirror: np.ndarray, o: np.ndarray, d: np.ndarray) -> int:
    """Number of rays that hit; fails where the mirrored result differs."""
    expected = what_is_cast(scene, o, d, np.ones(3))
    assert_same_bits(expected, what_is_cast(mirrored_scene(scene, mirror), o, d, mirror), f"mirrored by {mirror}")
    return int((expected["shape"] >= 0).sum())


@pytest.mark.parametrize("shape", SHAPES, ids=name)
def test_a_mirror_keeps_t_and_mirrors_positions_and_normals(shape):
    place = SHAPES.index(shape)
    rng = np.random.default_rng([50, place])
    hits = 0
    for mirror in (MIRRORS[place % 5], MIRRORS[(place + 2) % 5]):  # take turns
        scene = random_scene(rng, [shape], Pinhole, offset=rng.uniform(0.0, 10.0))
        for o, d in hard_rays(packed(scene), rng, 50).values():
            hits += count_hits_where_mirrors_agree(scene, np.array(mirror), o, d)
    assert hits >= 200

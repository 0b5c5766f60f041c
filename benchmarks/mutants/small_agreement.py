"""tests/agreement on films that plain Python renders in a second: cullings, and every AOV alone, give the same bits."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "agreement"))
from random_scenes import VIEWS, name, random_scene
from same_bits import assert_same_bits
from test_cullings import CULLINGS

from caster.aovs import BY_NAME
from caster.rendering.images import render
from caster.shapes import SHAPES

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
FILM = (9, 7)
COUNT = 3  # shapes a scene
MISSES = {"depth": np.inf, "shape_id": -1, "prim_id": -1}  # all others hold 0 there


@pytest.mark.parametrize("camera", VIEWS, ids=name)
@pytest.mark.parametrize("shape", SHAPES, ids=name)
def test_each_way_to_an_aov_gives_the_same_bits(shape, camera):
    if (SHAPES.index(shape) + VIEWS.index(camera)) % 3:
        return
    rng = np.random.default_rng([60, SHAPES.index(shape), VIEWS.index(camera)])
    scene = random_scene(rng, [shape], camera, count=COUNT, film=FILM)
    expected = render(scene, tuple(BY_NAME), threads=1, culling="brute-force")
    for aov, image in expected.items():
        assert (image[~expected.hit] == MISSES.get(aov, 0)).all(), aov
    for culling in CULLINGS:
        assert_same_bits(expected, render(scene, tuple(BY_NAME), threads=1, culling=culling), culling)
    for aov in BY_NAME:
        assert_same_bits({aov: expected[aov]}, dict(render(scene, (aov,), threads=1).items()), aov)

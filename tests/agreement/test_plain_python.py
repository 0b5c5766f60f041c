"""Compiled kernels and plain Python give the same bits."""

import os
import subprocess
import sys

import pytest
from plain_python import elsewhere, everything, inputs
from random_scenes import KINDS, VIEWS
from same_bits import assert_same_bits

from caster.shapes import SHAPES


@pytest.mark.parametrize(("share", "shapes"), [(2, KINDS), (1, SHAPES)])
@pytest.mark.slow("every shape before every camera in plain Python", keep=1)
def test_numba_and_plain_python_give_the_same_bits(share, shapes, tmp_path):
    """Every kind of primitive before half of the cameras, or every shape before all of them."""
    given = inputs(share, shapes)
    slow, compiled = elsewhere(tmp_path, given, CASTER_JIT="0"), everything(given)
    assert compiled.pop("compiled") and not slow.pop("compiled"), "one of the two must be compiled, and one not"
    assert_same_bits(slow, compiled, "Numba against plain Python")
    hits = sum(int((array >= 0).sum()) for key, array in slow.items() if key.endswith(("prim", "prim_id")))
    assert hits >= 800 / share
    films = {tuple(key.split()[:3]) for key in slow if key.endswith(" depth")}
    for place in range(3):
        assert len({film[place] for film in films}) == (len(shapes), len(VIEWS), 2)[place]
    assert len(films) >= len(shapes) * len(VIEWS) // share


TANGENT = """import caster
scene = caster.Scene(camera=caster.Pinhole(eye=(0, 0, 5), look_at=(0, 0, 0)), shapes=[caster.Cylinder()])
print(caster.cast(scene, [[1, 0, 0.5]], [[-1, 0, 0]]).t[0])"""


def test_an_undecided_root_gives_no_warning():
    """A ray across the axis that starts on the wall: 0 times an error of inf."""
    command, plain = [sys.executable, "-W", "error", "-c", TANGENT], os.environ | {"CASTER_JIT": "0"}
    run = subprocess.run(command, env=plain, capture_output=True, text=True, check=False)
    assert run.stdout == "2.0\n", run.stderr

"""Numba and plain Python run one source, and come to the same bits."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from plain_python import everything_cast
from random_scenes import VIEWS
from same_bits import assert_same_bits

from caster.shapes import SHAPES

SCRIPT = Path(__file__).with_name("plain_python.py")
ROOT = SCRIPT.parents[2]
PATIENCE = 300  # seconds; takes about 10


def plain(share: int, out: Path) -> dict[str, np.ndarray]:
    """What a process without the compiler gets."""
    environment = os.environ | {"CASTER_JIT": "0", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-W", "error", str(SCRIPT), str(out), str(share)]
    run = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE)
    assert run.returncode == 0, run.stderr
    with np.load(out) as arrays:
        return dict(arrays)


@pytest.mark.parametrize("share", [3, 1])
@pytest.mark.slow("every shape before every camera in plain Python", keep=1)
def test_numba_and_plain_python_give_the_same_bits(share, tmp_path):
    """A third of the cameras for each shape, both cullings among them, or all."""
    slow, compiled = plain(share, tmp_path / "plain.npz"), everything_cast(share)
    assert compiled.pop("compiled") and not slow.pop("compiled"), "one of the two must be compiled, and one not"
    assert_same_bits(slow, compiled, "Numba against plain Python")
    hits = sum(int((array >= 0).sum()) for key, array in slow.items() if key.endswith(("prim", "prim_id")))
    assert hits >= 5000 / share
    films = {tuple(key.split()[:3]) for key in slow if key.endswith(" depth")}
    for place in range(3):
        assert len({film[place] for film in films}) == (len(SHAPES), len(VIEWS), 2)[place]
    assert len(films) >= len(SHAPES) * len(VIEWS) // share

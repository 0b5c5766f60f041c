"""Numba and plain Python run one source, and come to the same bits."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from plain_python import everything_cast
from same_bits import assert_same_bits

SCRIPT = Path(__file__).with_name("plain_python.py")
ROOT = SCRIPT.parents[2]
PATIENCE = 300  # seconds; takes about 10


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> dict[str, np.ndarray]:
    """What a process without the compiler gets."""
    out = tmp_path_factory.mktemp("plain") / "plain.npz"
    environment = os.environ | {"CASTER_JIT": "0", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-W", "error", str(SCRIPT), str(out)]
    run = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE)
    assert run.returncode == 0, run.stderr
    with np.load(out) as arrays:
        return dict(arrays)


def test_numba_and_plain_python_give_the_same_bits(plain):
    compiled = everything_cast()
    assert compiled.pop("compiled") and not plain.pop("compiled"), (
        "one of the two must be compiled, and one not"
    )
    assert_same_bits(plain, compiled, "Numba against plain Python")
    hits = sum(int((array >= 0).sum()) for key, array in plain.items() if key.endswith(("prim", "prim_id")))
    assert hits >= 5000

"""Kernels are compiled once: what was done for them is counted, in processes with a cache folder of their own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from caster.jit import machine_code
from caster.jit.arguments import MISMATCH, checked_call, signature_key
from caster.jit.kernel_cache import COMPILED, compiler_version, source_hash

ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.skipif(not COMPILED, reason="without Numba nothing is compiled")

# Two small kernels of the caster, so that little is compiled: one that answers nothing, one that allocates.
SMALL = """
import sys
import numpy as np
from caster.jit.decorators import COMPILATION_LOG
from caster.kernels.surface.per_hit import store_hits
from caster.kernels.raster.tile import new_tile, PRIM, clear_rays
from caster.kernels.bvh.build import best_split_bin
COMPILATION_LOG.compiling = lambda name: print("compiling", name)
tile, hit = new_tile(), np.ones((2, 3), bool)
clear_rays(tile, 0, 4)
tile[PRIM + 1] = 5.0
store_hits(tile, (0, 0, 3, 2), hit, np.zeros((2, 3), bool))
assert hit.tolist()[0] == [False, True, False], hit
assert best_split_bin(np.ones(16, np.int64), np.tile(np.arange(16.0)[:, None], (1, 6))) in range(16)
print("compiled", len(COMPILATION_LOG.compiled), "loaded", len(COMPILATION_LOG.loaded), "numba" in sys.modules)
"""


def run(home: Path, *command: str, **more: str) -> subprocess.CompletedProcess[str]:
    env = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    env |= {"XDG_CACHE_HOME": str(home), "PYTHONPATH": str(ROOT), **more}
    return subprocess.run([sys.executable, *command], cwd=ROOT, env=env, capture_output=True, text=True)


def test_kernels_are_compiled_once_and_then_run_without_numba(tmp_path):
    first, second = run(tmp_path, "-c", SMALL), run(tmp_path, "-c", SMALL)
    assert first.returncode == 0 and second.returncode == 0, first.stderr + second.stderr
    assert first.stdout.splitlines()[0].startswith("compiling ")
    assert first.stdout.splitlines()[-1] == "compiled 3 loaded 0 True"
    assert second.stdout == "compiled 0 loaded 3 False\n"


def test_all_that_is_kept_lies_in_a_folder_named_after_the_source(tmp_path):
    """In a folder that outlives edits, Numba would take what was compiled with an older version of another file."""
    done = run(tmp_path / "home", "-c", SMALL, NUMBA_CACHE_DIR=str(tmp_path / "kept"))
    assert done.returncode == 0, done.stderr
    assert [path.name for path in (tmp_path / "kept").iterdir()] == [source_hash(compiler_version())]
    assert list((tmp_path / "kept").rglob("*.nbi")) and not (tmp_path / "home").exists()


def test_a_kept_kernel_that_is_damaged_is_compiled_anew(tmp_path):
    run(tmp_path, "-c", SMALL)
    kept = sorted(tmp_path.rglob("*.o"))
    assert len(kept) == 3
    kept[0].write_bytes(kept[0].read_bytes()[:-100])
    kept[1].write_bytes(b"")
    third = run(tmp_path, "-c", SMALL)
    assert third.returncode == 0, third.stderr
    assert third.stdout.endswith("True\n") and machine_code.read(kept[0]) is not None


def test_a_render_says_when_it_compiles_and_loads_no_compiler_when_it_need_not(tmp_path):
    """With the cache that all tests share: what is compiled for it is compiled for others, too."""
    scene, out = "scenes/one-sphere.toml", str(tmp_path / "x.exr")
    render = f"""
import sys
from caster.__main__ import main
assert main(["render", "{scene}", "--size", "8", "8", "--aov", "depth,normal", "-o", "{out}"]) == 0
print(sorted({{"numba", "llvmlite"}} & set(sys.modules)))
"""
    shared = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    first, second = run(shared, "-c", render), run(shared, "-c", render)
    assert first.returncode == 0 and second.returncode == 0, first.stderr + second.stderr
    assert first.stderr.count("\n") <= 1
    assert second.stderr == "" and second.stdout.endswith("['llvmlite']\n")


def test_a_call_made_for_some_classes_of_arguments_takes_no_others():
    """Machine code reads memory as it is told: an array of another type would be read beyond its end."""
    import numpy as np

    args = (np.zeros((3, 2)), 1, 2.5, (4, None))
    call = checked_call(args, lambda *flat: 0, "")
    assert call(*args) is None and call(np.ones((9, 2)), 7, np.float64(1), (0, None)) is None
    for other in (
        (np.zeros((3, 2), np.float32), 1, 2.5, (4, None)),
        (np.zeros(6), 1, 2.5, (4, None)),
        (np.zeros((3, 4))[:, ::2], 1, 2.5, (4, None)),
        (np.zeros((2, 3)).T, 1, 2.5, (4, None)),
        ([[0.0]], 1, 2.5, (4, None)),
        (args[0], 1.0, 2.5, (4, None)),
        (args[0], True, 2.5, (4, None)),
        (args[0], 1, 2, (4, None)),
        (args[0], 1, 2.5, (4, None, 1)),
        (args[0], 1, 2.5, (4, 0)),
        (args[0], 1, 2.5, [4, None]),
    ):
        assert call(*other) is MISMATCH, other
        assert signature_key(other) != signature_key(args), other

"""The kernel cache: numbers of compiled and loaded kernels, in processes with cache folders of their own."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from marks import compiled_only
from places import ROOT
from programs import printed_by, python

from caster.jit import machine_code
from caster.jit.arguments import describe, key_text
from caster.jit.decorators import COMPILATION_LOG, jit
from caster.jit.kernel_cache import COMPILED, claim, read_sealed, write_sealed

pytestmark = compiled_only

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


def run(home: Path, *command: str, tree: Path = ROOT, **more: str) -> subprocess.CompletedProcess[str]:
    return python(*command, cwd=tree, XDG_CACHE_HOME=str(home), PYTHONPATH=str(tree), **more)


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A folder with the cache of three kernels, as one process left it."""
    home = tmp_path_factory.mktemp("kept")
    first = run(home, "-c", SMALL)
    assert first.returncode == 0 and first.stdout.startswith("compiling "), first.stderr
    assert first.stdout.splitlines()[-1] == "compiled 3 loaded 0 True"
    return home


def test_kernels_are_compiled_once_and_then_run_without_numba(kept):
    again = run(kept, "-c", SMALL)
    assert again.returncode == 0 and again.stdout == "compiled 0 loaded 3 False\n", again.stderr


def files(home: Path) -> list[Path]:
    found = sorted(path for path in home.rglob("*") if path.is_file())
    assert {path.suffix for path in found} == {".o"} and len(found) == 3
    return found


def test_no_byte_of_a_kept_file_can_change(kept, tmp_path):
    """Nor its name, so that one kernel's code is never loaded as another's."""
    whole = min(files(kept), key=lambda path: path.stat().st_size)
    data, copy = whole.read_bytes(), tmp_path / whole.name
    copy.write_bytes(data)
    copy.chmod(0o600)
    assert read_sealed(copy) == data.partition(b"\n")[2]
    for at in range(len(data)):
        copy.write_bytes(data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :])
        with pytest.raises(ValueError, match="digest"):
            read_sealed(copy)
    copy.write_bytes(data)
    with pytest.raises(ValueError, match="digest"):
        read_sealed(copy.rename(tmp_path / "other.o"))


def test_code_that_llvm_cannot_load_is_compiled_anew(kept, tmp_path):
    """A file with a correct digest that is no object code, for instance of another version."""
    shutil.copytree(kept, tmp_path, dirs_exist_ok=True)
    (path,) = (path for path in files(tmp_path) if path.name.startswith("clear_rays-caster_"))
    whole = path.read_bytes()
    write_sealed(path, read_sealed(path).replace(b"caster_", b"caster-"))
    after = run(tmp_path, "-c", SMALL)
    assert after.returncode == 0 and after.stdout.endswith("compiled 1 loaded 2 True\n"), after.stderr
    assert path.read_bytes() == whole


@pytest.mark.slow("compiles kernels")
def test_a_disk_without_room_means_no_cache(tmp_path):
    """No file may grow beyond 1,000 bytes: kernels are compiled in each process, and nothing half-written stays."""
    limited = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n" + SMALL
    for _ in range(2):
        done = run(tmp_path, "-c", limited)
        assert done.returncode == 0 and done.stdout.endswith("compiled 3 loaded 0 True\n"), done.stderr
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_a_render_states_when_it_compiles_and_loads_no_compiler_when_it_need_not(tmp_path):
    """Uses the cache that all tests share, so that nothing is compiled for this test alone."""
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


@jit
def squares_below(limit: float) -> tuple[float, int]:
    total, count = 0.0, 0
    while count < limit:
        total += count * count
        count += 1
    return total, count


def test_a_kernel_that_answers_with_a_tuple_is_plain_python_where_python_calls_it():
    compiled = len(COMPILATION_LOG.compiled)
    assert squares_below(5.0) == (30.0, 5) and squares_below(5) == (30.0, 5)
    assert len(COMPILATION_LOG.compiled) == compiled


def pair(x):
    return x, x


def test_a_kernel_that_answers_otherwise_than_it_is_annotated_is_an_error():
    with pytest.raises(TypeError, match=r"pair answers .*: its annotation has to say so"):
        jit(pair)(1.0)


# ---- several processes

TWO = """
import os, sys, numpy as np
from caster.jit import decorators
from caster.jit.decorators import COMPILATION_LOG
from caster.kernels.raster.tile import new_tile, clear_rays, PRIM
from caster.kernels.bvh.build import best_split_bin
os.sched_getaffinity = lambda process: {0, 1}

def work(count):
    tile = new_tile()
    clear_rays(tile, 0, count)
    bins = best_split_bin(np.ones(16, np.int64), np.tile(np.arange(16.0)[:, None], (1, 6)))
    return tile[PRIM], bins

def small():
    where = work(4)
    with open("done", "a") as file:
        print(os.getpid(), where, file=file)

decorators.compile_ahead("work", small)
print(work(4))
print("compiled", len(COMPILATION_LOG.compiled), "loaded", len(COMPILATION_LOG.loaded))
decorators.compile_ahead("work", small)
print(work(4))
"""


def test_two_processes_share_what_is_to_be_compiled(tmp_path):
    """Both do all of the work, each kernel is compiled once, and with a full cache no second process starts."""
    script = tmp_path / "two.py"
    script.write_text(TWO)
    first, counts, second = printed_by(script, cwd=tmp_path, XDG_CACHE_HOME=str(tmp_path)).splitlines()
    ran = (tmp_path / "done").read_text().splitlines()
    assert first == second and len({line.split()[0] for line in ran}) == len(ran) == 2
    assert len({line.partition(" ")[2] for line in ran}) == 1
    compiled, loaded = map(int, counts.split()[1::2])
    assert compiled + loaded >= 2 and 0 < compiled <= 2
    assert len(list(tmp_path.rglob("*.o"))) == 2 and not list(tmp_path.rglob("*.lock"))


def test_a_claim_is_one_process_s_and_ends_with_it(tmp_path):
    path = tmp_path / "kernel.o"
    hold = "import sys; from pathlib import Path; from caster.jit.kernel_cache import claim\n"
    hold += f"with claim(Path({str(path)!r}), wait=True): print('held', flush=True); sys.stdin.read()"
    with subprocess.Popen([sys.executable, "-c", hold], cwd=ROOT, stdin=-1, stdout=-1, text=True) as other:
        assert other.stdout.readline() == "held\n"
        with claim(path, wait=False) as mine:
            assert not mine
        other.kill()
        with claim(path, wait=True) as mine:
            assert mine
    with claim(tmp_path / "no folder" / "kernel.o", wait=True) as mine:
        assert mine


LATE_GENERICS = """
from caster.jit import decorators
compiler = decorators._compiler()  # as when a mesh file is read before anything of rendering is imported
from caster.kernels.bvh import fans
context = compiler.KernelDispatcher.targetdescr.typing_context
context.refresh()
for function in (fans.outline, fans.separating_plane):
    context.resolve_value_type(function)  # raises where Numba has not been given it
print("typed")
"""


def test_functions_of_the_protocol_may_be_imported_after_numba_is_loaded(tmp_path):
    done = run(tmp_path, "-c", LATE_GENERICS)
    assert done.stdout == "typed\n", done.stderr


def test_arguments_of_other_classes_have_another_key():
    """Machine code for another array type would read beyond the end of the array."""
    args = (np.zeros((3, 2)), 1, 2.5, (4, None))
    key = describe(args).key
    assert describe((np.ones((9, 2)), 7, np.float64(1), (0, None))).key == key
    for other in (
        (np.zeros((3, 2), np.float32), 1, 2.5, (4, None)),
        (np.zeros(6), 1, 2.5, (4, None)),
        (np.zeros((3, 4))[:, ::2], 1, 2.5, (4, None)),
        (np.zeros((2, 3)).T, 1, 2.5, (4, None)),
        (args[0], 1.0, 2.5, (4, None)),
        (args[0], True, 2.5, (4, None)),
        (args[0], 1, 2, (4, None)),
        (args[0], 1, 2.5, (4, None, 1)),
        (args[0], 1, 2.5, (4, 0)),
    ):
        assert describe(other).key != key and key_text(describe(other).key) != key_text(key), other
    for other in (([[0.0]], 1, 2.5, (4, None)), (args[0], 1, 2.5, [4, None]), (np.float32(1),)):
        assert describe(other) is None


# ---- object code that a wheel brings

portable = pytest.mark.skipif(
    not (COMPILED and machine_code.runs_portable_code()), reason="object code is for x86-64-v3"
)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The package with object code of the three kernels, as .ci/wheel_with_kernels.py puts it into a wheel."""
    tree, home = tmp_path_factory.mktemp("tree"), tmp_path_factory.mktemp("home")
    without = shutil.ignore_patterns("__pycache__", "object_code")
    shutil.copytree(ROOT / "caster", tree / "caster", ignore=without)
    assert run(home, "-c", SMALL, tree=tree, **machine_code.portable_settings()).returncode == 0
    folder = tree / "caster/jit/object_code"
    folder.mkdir()
    for path in home.rglob("*.o"):
        shutil.copy(path, folder)
    return tree


@pytest.fixture
def tree(built, tmp_path):
    return shutil.copytree(built, tmp_path / "tree")


@portable
def test_a_wheel_with_object_code_compiles_nothing(tree, tmp_path):
    done = run(tmp_path / "home", "-c", SMALL, tree=tree)
    assert done.returncode == 0 and done.stdout == "compiled 0 loaded 3 False\n", done.stdout + done.stderr
    assert not list((tmp_path / "home").rglob("*.o"))


def of_other_sources(tree: Path) -> None:
    """Edit a source of the compiler, as in a checkout over an old build."""
    path = tree / "caster/jit/simd.py"
    path.write_text(path.read_text() + "# edited\n")


def for_a_better_processor(tree: Path) -> None:
    """This processor lacks a feature."""
    (tree / "sitecustomize.py").write_text(
        "import llvmlite.binding as llvm\nfound = dict(llvm.get_host_cpu_features(), bmi2=False)\n"
        "llvm.get_host_cpu_features = lambda: type('Features', (dict,), {'flatten': lambda self: ''})(found)\n"
    )


UNFIT = (of_other_sources, for_a_better_processor)


@portable
@pytest.mark.parametrize("spoil", UNFIT, ids=lambda spoil: spoil.__name__)
@pytest.mark.slow("each compiles kernels", keep=1)
def test_object_code_that_does_not_fit_is_compiled_anew(tree, tmp_path, spoil):
    """All kernels are compiled, with the same results, and kept."""
    spoil(tree)
    done = run(tmp_path / "home", "-c", SMALL, tree=tree)
    assert done.returncode == 0 and done.stdout.endswith("compiled 3 loaded 0 True\n"), done.stdout + done.stderr
    assert len(files(tmp_path / "home")) == 3

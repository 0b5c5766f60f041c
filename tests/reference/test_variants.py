"""The choice of a variant: those that work are found by trying, and stored."""

import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mitsuba_scenes import has_t, job, shape, write
from outputs import unfolded

from mitsuba_ref.reference import messages, mitsuba_process, variants
from mitsuba_ref.reference.interpreter import VARIANT_VARIABLE, Installation
from mitsuba_ref.reference.messages import Crash, TraceResponse
from mitsuba_ref.reference.variants import LIBLLVM_ENVIRONMENT_VARIABLE, VariantError, usable_variants, variant_for

OLD_LLVM = Path("/usr/lib/x86_64-linux-gnu/libLLVM-15.so.1")


@pytest.fixture(autouse=True)
def nothing_known(tmp_path, monkeypatch):
    """An empty cache folder, nothing remembered, nothing chosen."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv(VARIANT_VARIABLE, raising=False)
    monkeypatch.setattr(variants, "_outcomes", {})


@pytest.fixture
def trials(monkeypatch):
    """Replace the smoke test: `says` are its outcomes, `tried` the (variant, libLLVM) that were tried."""
    tried, says = [], {}

    def trial(variant, settings):
        tried.append((variant, settings.get(LIBLLVM_ENVIRONMENT_VARIABLE)))
        return says.get(tried[-1], "")

    monkeypatch.setattr(variants, "smoke_test", trial)
    trial.tried, trial.says = tried, says
    return trial


@pytest.fixture
def libraries(tmp_path, monkeypatch):
    """Libraries 14, 9, 21.1 and 19.1 in a folder of the library path, and no others."""
    folder = tmp_path / "lib"
    folder.mkdir()
    for name in ("libLLVM-14.so.1", "libLLVM-9.so", "libLLVM.so.21.1", "libLLVM.so.19.1"):
        (folder / name).write_text("not a library")
    (folder / "libLLVM-21.so").symlink_to("libLLVM.so.21.1")
    for name in ("libLLVMSPIRVLib.so.22", "libLLVM-23-rust.so", "libLLVM.so.24.dSYM"):
        (folder / name).write_text("not LLVM itself")
    (folder / "libLLVM-99.so").mkdir()
    monkeypatch.delenv(LIBLLVM_ENVIRONMENT_VARIABLE, raising=False)
    monkeypatch.setattr(variants, "LIBLLVM_PATTERNS", ())
    monkeypatch.setenv("LD_LIBRARY_PATH", f"{folder}:")
    return [str(folder / name) for name in ("libLLVM.so.21.1", "libLLVM.so.19.1", "libLLVM-14.so.1", "libLLVM-9.so")]


def forget(monkeypatch):
    """Forget outcomes, as a new process has none."""
    monkeypatch.setattr(variants, "_outcomes", {})


def test_what_is_stated_to_work_here_works(tmp_path):
    found = usable_variants()
    assert found.scalar, found.why
    assert found.libllvm or found.why
    xml = write(tmp_path, shape("cube", "box", 0))
    for variant in found.names:
        answer = mitsuba_process.send_request(job(xml, variant, [[0.5, 0.25, 5]], [[0, 0, -1]]), 60)
        assert isinstance(answer, TraceResponse) and has_t(answer, 4.0), answer
        assert answer.versions["libllvm"] == "none" or os.path.samefile(answer.versions["libllvm"], found.libllvm)


@pytest.mark.parametrize("missing", ["/nonexistent/libLLVM.so", str(Path(__file__))])
@pytest.mark.slow("each starts processes of its own", keep=1)
def test_without_libllvm_there_is_the_scalar_variant(tmp_path, monkeypatch, missing):
    monkeypatch.setenv(LIBLLVM_ENVIRONMENT_VARIABLE, missing)
    found = usable_variants()
    assert found.names == ("scalar_rgb",) and found.libllvm is None
    assert missing in found.why
    assert variant_for(False) == variant_for(True) == "scalar_rgb"
    xml = write(tmp_path, shape("rectangle", "floor", 0))
    answer = mitsuba_process.send_request(job(xml, variant_for(False), [[0, 0, 3]], [[0, 0, -1]]), 60)
    assert isinstance(answer, TraceResponse) and has_t(answer, 3.0)
    refused = mitsuba_process.send_request(job(xml, "llvm_ad_rgb", [[0, 0, 3]], [[0, 0, -1]]), 60)
    assert isinstance(refused, Crash) and refused.code == 1 and "LLVM" in refused.output


@pytest.mark.skipif(not OLD_LLVM.exists(), reason=f"{OLD_LLVM} is not installed")
def test_an_old_libllvm_that_aborts_is_found_out(monkeypatch):
    monkeypatch.setenv(LIBLLVM_ENVIRONMENT_VARIABLE, str(OLD_LLVM))
    found = usable_variants()
    assert found.scalar and not found.libllvm
    assert "SIGABRT: LLVM ERROR" in found.why and "fminimum" in found.why


def test_each_trial_compiles_its_kernels_anew(monkeypatch):
    """A kernel in the cache of another libLLVM would hide an abort."""
    folders = []

    def put(job, timeout, settings):
        folders.append(Path(settings["DRJIT_CACHE_DIR"]))
        assert not list(folders[-1].glob("*.bin"))
        return Crash(1, "no", 0.0)

    monkeypatch.setattr(messages, "run_request", put)
    assert variants.smoke_test("llvm_ad_rgb", {}) == "exit code 1: no"
    variants.smoke_test("llvm_ad_rgb", {})
    assert folders[0] != folders[1] and not folders[0].exists()


@pytest.fixture
def problem_of(monkeypatch):
    """What the smoke test says of an answer."""

    def found(t=(8.0, np.inf), normal=(0.0, 0.0, 1.0)) -> str:
        answer = SimpleNamespace(t=np.array(t, np.float32), sh_n=np.array([normal, (0.0, 0.0, 0.0)], np.float32))
        monkeypatch.setattr(messages, "run_request", lambda *_: answer)
        return variants.smoke_test("llvm_ad_rgb", {})

    return found


def ulps(x: float, count: int) -> float:
    """The float32 number `count` units in the last place from x."""
    return float((np.array([x], np.float32).view(np.int32) + count).view(np.float32)[0])


def test_what_the_reciprocals_of_any_cpu_leave_is_right(problem_of):
    """Below 8 and 1, a unit in the last place is 2^-24 of the number, above twice that."""
    for t in (ulps(8.0, -5), 8.0, ulps(8.0, 2)):
        for z in (ulps(1.0, -8), 1.0, ulps(1.0, 4)):
            assert problem_of((t, np.inf), (0.0, 0.0, z)) == ""


def test_a_wrong_answer_is_no_working_variant(problem_of):
    times = [
        (ulps(8.0, -6), np.inf),
        (ulps(8.0, 3), np.inf),
        (np.nan, np.inf),
        (np.inf, np.inf),
        (8.0, 8.0),
        (8.0, np.nan),
    ]
    normals = [(0.0, 0.0, ulps(1.0, -9)), (0.0, 0.0, -1.0), (0.0, 1e-6, 1.0), (0.0, 0.0, np.nan)]
    for wrong in (*({"t": t} for t in times), *({"normal": normal} for normal in normals)):
        assert problem_of(**wrong).startswith("wrong answer: t ["), wrong


def test_the_newest_library_that_works_is_taken(libraries, trials):
    trials.says["llvm_ad_rgb", libraries[0]] = "abort"
    found = usable_variants()
    assert found.names == variants.VARIANT_NAMES and found.libllvm == libraries[1]
    assert trials.tried == [("scalar_rgb", None), ("llvm_ad_rgb", libraries[0]), ("llvm_ad_rgb", libraries[1])]
    assert found.why == f"{libraries[0]}: abort"
    assert variants._candidates() == libraries


def test_a_library_the_user_names_is_the_only_one_tried(libraries, trials, monkeypatch):
    monkeypatch.setenv(LIBLLVM_ENVIRONMENT_VARIABLE, libraries[3])
    assert usable_variants().libllvm == libraries[3]
    assert trials.tried == [("scalar_rgb", None), ("llvm_ad_rgb", libraries[3])]


def test_no_library_at_all_is_stated(libraries, trials, monkeypatch):
    monkeypatch.delenv("LD_LIBRARY_PATH")
    assert usable_variants() == variants.Variants(True, None, *["no libLLVM found"] * 2)


@pytest.mark.parametrize("change", ["mtime", "size", "gone", "versions", "processor", "chosen"])
def test_another_library_or_another_mitsuba_is_tried_again(libraries, trials, monkeypatch, change):
    first = usable_variants()
    assert usable_variants() == first and len(trials.tried) == 2
    forget(monkeypatch)
    assert usable_variants() == first and len(trials.tried) == 2  # by the next process
    forget(monkeypatch)
    if change == "mtime":
        os.utime(libraries[0], (1, 1))
    elif change == "size":
        stamp = os.stat(libraries[0]).st_mtime_ns
        Path(libraries[0]).write_text("longer than it was before")
        os.utime(libraries[0], ns=(stamp, stamp))
    elif change == "gone":
        Path(libraries[0]).unlink()
    elif change == "versions":
        monkeypatch.setattr(variants, "machine", lambda: {"mitsuba": "9.9.9"})
    elif change == "processor":
        monkeypatch.setattr(variants, "machine", lambda: {"processor": "GenuineIntel family 6"})
    else:
        monkeypatch.setenv(LIBLLVM_ENVIRONMENT_VARIABLE, libraries[0])
    usable_variants()
    assert len(trials.tried) == (4 if change in ("versions", "processor", "chosen") else 3)  # scalar has no library


@pytest.mark.parametrize("problem", ["killed after 60 s", "exit code 1: no module mitsuba", "SIGKILL"])
def test_a_machine_that_was_only_busy_or_unfinished_is_tried_again(libraries, trials, monkeypatch, problem):
    trials.says["scalar_rgb", None] = problem
    assert not usable_variants().scalar
    forget(monkeypatch)
    trials.says.clear()
    assert usable_variants().scalar


def test_without_mitsuba_no_library_is_tried_and_the_way_out_is_pip(libraries, trials):
    trials.says["scalar_rgb", None] = "exit code 1: No module named 'mitsuba'"
    with pytest.raises(VariantError, match=r"^Mitsuba is not installed: pip install mitsuba==[\d.]+ drjit==[\d.]+$"):
        variants.require_variants()
    assert len(trials.tried) == 1


@pytest.mark.parametrize("problem", ["wrong answer: t [7.0, inf]", "SIGILL"])
@pytest.mark.parametrize("variant", variants.VARIANT_NAMES)
def test_what_would_end_alike_is_not_tried_again(libraries, trials, monkeypatch, variant, problem):
    """Otherwise each process would try all libraries again, which takes seconds."""
    trials.says.update({(variant, library): problem for library in (None, *libraries)})
    first = usable_variants()
    tried = len(trials.tried)
    assert variant not in first.names and len(first.names) == 1
    forget(monkeypatch)
    assert usable_variants() == first and len(trials.tried) == tried


def test_curved_shapes_go_to_the_scalar_variant_unless_one_is_chosen(libraries, trials, monkeypatch):
    assert [variant_for(has_quadrics) for has_quadrics in (False, True)] == ["llvm_ad_rgb", "scalar_rgb"]
    for chosen in variants.VARIANT_NAMES:
        monkeypatch.setenv(VARIANT_VARIABLE, chosen)
        assert variant_for(False) == variant_for(True) == chosen


@pytest.mark.parametrize(
    ("chosen", "says"),
    [
        ("cuda_rgb", "^--variant 'cuda_rgb': expected scalar_rgb or .*cuda_ad_rgb, whose light is in rgb, as it is co"),
        ("scalar_spectral", "^--variant 'scalar_spectral': expected scalar_rgb or "),
        (
            "llvm_ad_rgb",
            "'llvm_ad_rgb': it does not work here: .*libLLVM.so.21.1: abort; .*: abort; and 2 more libraries",
        ),
    ],
)
def test_a_choice_that_is_unknown_or_does_not_work_is_an_error(libraries, trials, monkeypatch, chosen, says):
    trials.says.update({("llvm_ad_rgb", library): "abort" for library in libraries})
    monkeypatch.setenv(VARIANT_VARIABLE, chosen)
    with pytest.raises(VariantError, match=says):
        variant_for(False)


WRONG = "wrong answer: t [7.0, inf], normals [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]"


def test_without_the_scalar_variant_no_sphere_is_traced(libraries, trials):
    trials.says["scalar_rgb", None] = WRONG
    assert variant_for(has_quadrics=False) == "llvm_ad_rgb"
    for choose in (lambda: variant_for(has_quadrics=True), variants.require_variants):
        with pytest.raises(
            VariantError, match=r"^Mitsuba's scalar_rgb does not work here: scalar_rgb: wrong ans"
        ) as it:
            choose()
        assert "`mitsuba-ref doctor`" in str(it.value)


def test_a_libllvm_that_does_not_work_is_stated_once(libraries, trials, monkeypatch, capsys):
    variants.require_variants()
    assert capsys.readouterr().err == ""
    forget(monkeypatch)
    Path(libraries[0]).unlink()  # so that they are tried again
    trials.says.update({("llvm_ad_rgb", library): "SIGABRT" for library in libraries})
    variants.require_variants()
    line = unfolded(capsys.readouterr().err)
    assert line.startswith("llvm_ad_rgb does not work here, scalar_rgb traces all scenes (`mitsuba-ref doctor` ")
    assert f"{libraries[1]}: SIGABRT; {libraries[2]}: SIGABRT" in line
    monkeypatch.setenv(VARIANT_VARIABLE, "scalar_rgb")
    variants.require_variants()
    assert capsys.readouterr().err == ""


def test_any_rgb_variant_that_works_is_taken_and_tried_once(libraries, trials, monkeypatch):
    """CUDA, or float64 where the build has it; a GPU that is missing is said so."""
    built = Installation({}, ("scalar_rgb", "cuda_ad_rgb", "scalar_rgb_double", "llvm_ad_rgb_double"), "")
    monkeypatch.setattr(variants, "installation", lambda: built)
    trials.says["cuda_ad_rgb", None] = "exit code 1: jit: the CUDA backend hasn't been initialized."
    for chosen in built.variants[2:] * 2:
        monkeypatch.setenv(VARIANT_VARIABLE, chosen)
        assert variant_for(False) == variant_for(True) == chosen
    assert trials.tried[-2:] == [("scalar_rgb_double", None), ("llvm_ad_rgb_double", libraries[0])]
    monkeypatch.setenv(VARIANT_VARIABLE, "cuda_ad_rgb")
    with pytest.raises(VariantError, match=r"^--variant 'cuda_ad_rgb': it does not work here: no CUDA device wa"):
        variants.require_variants()

"""Which variant is asked: what works here, found by trying, and remembered."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mitsuba_scenes import job, shape, write

from mitsuba_ref.reference import messages, mitsuba_process, variants
from mitsuba_ref.reference.messages import Crash, TraceResponse
from mitsuba_ref.reference.variants import LIBLLVM_ENVIRONMENT_VARIABLE, VariantError, usable_variants, variant_for

ROOT = Path(__file__).resolve().parents[2]
OLD_LLVM = Path("/usr/lib/x86_64-linux-gnu/libLLVM-15.so.1")


@pytest.fixture(autouse=True)
def nothing_known(tmp_path, monkeypatch):
    """An empty cache folder, nothing remembered, nothing chosen."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv(variants.VARIANT_ENVIRONMENT_VARIABLE, raising=False)
    monkeypatch.setattr(variants, "_usable_by_key", {})


@pytest.fixture
def trials(monkeypatch):
    """What the trials say instead of trying; returns the list of (variant, libLLVM) that were tried."""
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
    """As a new process would."""
    monkeypatch.setattr(variants, "_usable_by_key", {})


def test_what_is_stated_to_work_here_works(tmp_path):
    found = usable_variants()
    assert found.scalar, found.why
    assert found.llvm == bool(found.libllvm) and (found.llvm or found.why)
    xml = write(tmp_path, shape("cube", "box", 0))
    for variant in found.names:
        answer = mitsuba_process.send_request(job(xml, variant, [[0.5, 0.25, 5]], [[0, 0, -1]]), 60)
        assert isinstance(answer, TraceResponse) and answer.t.tolist() == [4.0], answer
        assert answer.versions["libllvm"] == "none" or os.path.samefile(answer.versions["libllvm"], found.libllvm)


def test_the_child_process_describes_it():
    describe = "from mitsuba_ref.reference.mitsuba_calls import describe_installation"
    program = f"import json; {describe}; print(json.dumps(describe_installation()))"
    run = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert json.loads(run.stdout) == {"variants": list(usable_variants().names), "libllvm": usable_variants().libllvm}


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
    assert isinstance(answer, TraceResponse) and answer.t.tolist() == [3.0]
    refused = mitsuba_process.send_request(job(xml, "llvm_ad_rgb", [[0, 0, 3]], [[0, 0, -1]]), 60)
    assert isinstance(refused, Crash) and refused.kind == "error" and "LLVM" in refused.output


@pytest.mark.skipif(not OLD_LLVM.exists(), reason=f"{OLD_LLVM} is not installed")
def test_an_old_libllvm_that_aborts_is_found_out(monkeypatch):
    monkeypatch.setenv(LIBLLVM_ENVIRONMENT_VARIABLE, str(OLD_LLVM))
    found = usable_variants()
    assert found.scalar
    if "avx512" in Path("/proc/cpuinfo").read_text():
        assert not found.llvm and "abort (SIGABRT) LLVM ERROR" in found.why and "fminimum" in found.why


def test_each_trial_compiles_its_kernels_anew(monkeypatch):
    """A kernel in the cache of another libLLVM would hide an abort."""
    folders = []

    def put(job, timeout, settings):
        folders.append(Path(settings["DRJIT_CACHE_DIR"]))
        assert not list(folders[-1].glob("*.bin"))
        return Crash("error", "no", "exit code 1", 0.0)

    monkeypatch.setattr(messages, "run_request", put)
    assert variants.smoke_test("llvm_ad_rgb", {}) == "error (exit code 1) no"
    variants.smoke_test("llvm_ad_rgb", {})
    assert folders[0] != folders[1] and not folders[0].exists()


@pytest.mark.parametrize("wrong", ["t", "sh_n"])
def test_a_wrong_answer_is_no_working_variant(monkeypatch, wrong):
    def put(job, timeout, settings):
        answer = real(job, timeout, settings)
        getattr(answer, wrong)[0] *= np.float32(1.001)
        return answer

    real = messages.run_request
    monkeypatch.setattr(messages, "run_request", put)
    assert variants.smoke_test("scalar_rgb", {}).startswith("wrong answer")


def test_the_newest_library_that_works_is_taken(libraries, trials):
    trials.says["llvm_ad_rgb", libraries[0]] = "abort"
    found = usable_variants()
    assert found.names == variants.VARIANT_NAMES and found.libllvm == libraries[1]
    assert trials.tried == [("scalar_rgb", None), ("llvm_ad_rgb", libraries[0]), ("llvm_ad_rgb", libraries[1])]
    assert found.why == f"{libraries[0]}: abort"
    assert list(variants._candidates()) == libraries


def test_a_library_the_user_names_is_the_only_one_tried(libraries, trials, monkeypatch):
    monkeypatch.setenv(LIBLLVM_ENVIRONMENT_VARIABLE, libraries[3])
    assert usable_variants().libllvm == libraries[3]
    assert trials.tried == [("scalar_rgb", None), ("llvm_ad_rgb", libraries[3])]


def test_no_library_at_all_is_stated(libraries, trials, monkeypatch):
    monkeypatch.delenv("LD_LIBRARY_PATH")
    assert usable_variants() == variants.Variants(True, False, None, "no libLLVM found")


def test_what_was_found_is_remembered_by_the_next_process(libraries, trials, monkeypatch):
    first = usable_variants()
    assert usable_variants() is first and len(trials.tried) == 2
    forget(monkeypatch)
    assert usable_variants() == first and len(trials.tried) == 2


@pytest.mark.parametrize("change", ["mtime", "size", "gone", "versions", "chosen"])
def test_another_library_or_another_mitsuba_is_tried_again(libraries, trials, monkeypatch, change):
    usable_variants()
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
        monkeypatch.setattr(variants, "installed_version", lambda name: "9.9.9")
    else:
        monkeypatch.setenv(LIBLLVM_ENVIRONMENT_VARIABLE, libraries[0])
    usable_variants()
    assert len(trials.tried) == 4


@pytest.mark.parametrize(
    "content", ["", "{", "[]", "7", '{"scalar": true}', '{"scalar": 1, "llvm": true, "libllvm": null, "why": ""}']
)
def test_a_broken_memory_costs_time_only(libraries, trials, monkeypatch, tmp_path, content):
    first = usable_variants()
    (file,) = (tmp_path / "cache").rglob("*.json")
    file.write_text(content)
    forget(monkeypatch)
    assert usable_variants() == first and len(trials.tried) == 4
    forget(monkeypatch)
    assert usable_variants() == first and len(trials.tried) == 4, "it was not mended"


def test_a_cache_folder_that_cannot_be_made_costs_time_only(libraries, trials, monkeypatch, tmp_path):
    (tmp_path / "cache").write_text("a file is in the way")
    first = usable_variants()
    forget(monkeypatch)
    assert usable_variants() == first and len(trials.tried) == 4


@pytest.mark.parametrize("problem", ["timeout (killed after 60 s)", "error (exit code 1) no module mitsuba"])
def test_a_machine_that_was_only_busy_or_unfinished_is_tried_again(libraries, trials, monkeypatch, problem):
    trials.says["scalar_rgb", None] = problem
    assert not usable_variants().scalar
    forget(monkeypatch)
    trials.says.clear()
    assert usable_variants().scalar


def test_triangles_go_to_llvm_and_curved_shapes_to_the_scalar_variant(libraries, trials):
    assert variant_for(has_quadrics=False) == "llvm_ad_rgb"
    assert variant_for(has_quadrics=True) == "scalar_rgb"


@pytest.mark.parametrize("has_quadrics", [True, False])
@pytest.mark.parametrize("chosen", variants.VARIANT_NAMES)
def test_a_chosen_variant_is_used_for_every_scene(libraries, trials, monkeypatch, chosen, has_quadrics):
    monkeypatch.setenv(variants.VARIANT_ENVIRONMENT_VARIABLE, chosen)
    assert variant_for(has_quadrics) == chosen


def test_an_unknown_choice_is_an_error_that_lists_the_known_ones(monkeypatch):
    monkeypatch.setenv(variants.VARIANT_ENVIRONMENT_VARIABLE, "cuda_rgb")
    with pytest.raises(VariantError, match=r"^MITSUBA_REF_VARIANT 'cuda_rgb': expected scalar_rgb or llvm_ad_rgb$"):
        variant_for(False)


def test_a_choice_that_does_not_work_here_is_an_error_that_states_why(libraries, trials, monkeypatch):
    trials.says.update({("llvm_ad_rgb", library): "abort" for library in libraries})
    monkeypatch.setenv(variants.VARIANT_ENVIRONMENT_VARIABLE, "llvm_ad_rgb")
    with pytest.raises(VariantError, match=r"'llvm_ad_rgb': it does not work here: .*libLLVM-14.so.1: abort"):
        variant_for(False)


def test_a_library_that_only_the_kept_file_names_is_not_loaded(libraries, trials, monkeypatch):
    """Whoever may write the file would have code run: its path has to be one that was found on this machine."""
    before = usable_variants()
    (kept,) = (Path(os.environ["XDG_CACHE_HOME"]) / "caster/variants").glob("*.json")
    written = kept.read_text(encoding="utf-8")
    planted = str(kept.with_name("libLLVM.so.99"))
    for text in (
        written.replace(before.libllvm, planted),
        json.dumps(json.loads(written) | {"llvm": False}),
        json.dumps(json.loads(written) | {"libllvm": None}),
        json.dumps(json.loads(written) | {"llvm": 1}),
        "[" * 100_000,
    ):
        assert text != written
        kept.write_text(text, encoding="utf-8")
        forget(monkeypatch)
        trials.tried.clear()
        assert usable_variants() == before and trials.tried

"""Verdicts and tests hold under older instruction sets of Embree than this CPU's; a limit without effect is noticed."""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import isa_runs
import pytest
from isa_runs import Limit, LimitError, available, check_limits, compiled, count_differences, limits, validate

from mitsuba_ref.reference.variants import usable_variants

WITH_AND_WITHOUT_FMA = tuple(isa for isa in ("sse4.2", "avx2") if isa in available())
SCENES = "torus-smooth or every-shape or lights-and-shadows"
RESPONSES = "tests/reference/test_mitsuba_responses.py"
NUMBERS = "inf_minus_one or lengths_of_d or same_bits or direct_integrator"

WIDE = usable_variants().libllvm and "avx512f" in Path("/proc/cpuinfo").read_text()

pytestmark = pytest.mark.skipif(not WITH_AND_WITHOUT_FMA, reason="not an x86-64 CPU: Embree has one instruction set")


@pytest.fixture(scope="module")
def limited() -> Iterator[dict[str, Limit]]:
    try:
        with limits(WITH_AND_WITHOUT_FMA) as found:
            yield found
    except LimitError as problem:
        if "no C compiler" in str(problem):
            pytest.skip(str(problem))
        raise


@pytest.mark.parametrize("isa", WITH_AND_WITHOUT_FMA)
@pytest.mark.slow("judges scenes with a Mitsuba that compiles anew", keep=1)
def test_scenes_pass(limited, tmp_path, isa):
    options = ("-k", SCENES, "--size", "24", "24", "-j", "1")
    ok, text, counts = validate(limited[isa], "scenes", tmp_path / "verdict.json", *options)
    assert ok and len(counts) == SCENES.count(" or ") + 1, text


@pytest.mark.parametrize("isa", WITH_AND_WITHOUT_FMA)
@pytest.mark.slow("runs pytest with a Mitsuba that compiles anew")
def test_tests_of_mitsubas_numbers_pass(limited, isa):
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-n", "0", RESPONSES]
    done = limited[isa].run([*command, "-k", f"works_here or {NUMBERS}", "tests/reference/test_variants.py"])
    passed = re.search(r"(\d+) passed", done.stdout)
    assert done.returncode == 0 and passed and int(passed[1]) >= 6, done.stdout


# ---- a limit without effect ----


@pytest.mark.parametrize(
    ("original", "edited", "says"),
    [
        (",max_isa=%s", ",ignored=%s", "sse4.2: Embree says that it uses AVX"),
        ("rtcNewDeviceEPKc", "rtcOldDeviceEPKc", "sse4.2: no Embree device was made"),
        pytest.param(
            "width() > 8",
            "width() > 99",
            "sse4.2: LLVM code takes 16 rays at once, expected 8",
            marks=pytest.mark.skipif(
                not WIDE, reason="LLVM code of this machine takes 8 rays at once, or there is none"
            ),
        ),
    ],
)
def test_a_library_without_effect_is_noticed(limited, tmp_path, monkeypatch, original, edited, says):
    source = (isa_runs.HERE / "isa_limit.c").read_text()
    assert original in source
    (tmp_path / "isa_limit.c").write_text(source.replace(original, edited))
    monkeypatch.setattr(isa_runs, "HERE", tmp_path)
    with pytest.raises(LimitError, match=f"^{says}"):
        check_limits({"sse4.2": Limit("sse4.2", compiled(tmp_path), tmp_path / "log")})


def test_a_run_without_mitsuba_is_noticed(limited):
    with pytest.raises(LimitError, match="no Embree device was made by"):
        limited["sse4.2"].run([sys.executable, "-c", "print('nothing')"])


def test_a_machine_without_a_compiler_is_told(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert isa_runs.main(["sse4.2"]) == 4
    assert capsys.readouterr().err.startswith("isa_runs: no C compiler: cc; on Debian and Ubuntu: apt install gcc")


def test_counts_that_differ_are_listed_and_only_some_may():
    one = {"agree": 90, "tie": 6, "explained": 4, "wrong": 0}
    assert [*count_differences({"a": one}, {"a": one})] == []
    assert [*count_differences({"a": one}, {"a": one | {"agree": 91, "tie": 5}})] == [
        ("a: 90 -> 91 agree, 6 -> 5 tie", True)
    ]
    ((_, allowed),) = count_differences({"a": one}, {"a": one | {"agree": 89, "wrong": 1}})
    ((words, missing),) = count_differences({"a": one}, {})
    assert not allowed and not missing and "90 -> None agree" in words

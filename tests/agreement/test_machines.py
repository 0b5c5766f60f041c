"""All processors give the same bits; others are simulated by settings of libraries and compiler.

A BLAS, NumPy and the C library choose code by the features of the processor, each with other last bits; so does LLVM,
which has instructions to choose from. Here they are told to do without.
"""

import platform

import numpy as np
import pytest
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__
from plain_python import elsewhere, inputs
from same_bits import assert_same_bits

from caster.system import processor

X86 = platform.machine() == "x86_64"
DISPATCHED = " ".join(name for name in __cpu_dispatch__ if __cpu_features__.get(name))
OLDEST = {
    "OPENBLAS_CORETYPE": "Nehalem",
    "NPY_DISABLE_CPU_FEATURES": DISPATCHED,
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-FMA4,-AVX2,-AVX512F",
}
SANDYBRIDGE, HASWELL, SKYLAKE_X = ({"OPENBLAS_CORETYPE": name} for name in ("Sandybridge", "Haswell", "SkylakeX"))
NUMBA_TARGETS = ("generic", "x86-64-v2", "x86-64-v3")
LIBRARIES = ("BLAS", "NumPy", "C")


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """(what is given, what this machine gets of it in plain Python), by the share."""
    known = {}

    def of(share):
        if share not in known:
            given = inputs(share)
            known[share] = given, elsewhere(tmp_path_factory.mktemp("here"), given, CASTER_JIT="0")
        return known[share]

    return of


def assert_ours_alike(found, expected, what):
    """Results of libraries may differ."""
    ours = [{key: each[key] for key in each if key not in (*LIBRARIES, "compiled")} for each in (found, expected)]
    assert len(ours[0]) > 300
    assert_same_bits(*ours, what)


@pytest.mark.skipif(not X86, reason="the features are those of x86-64")
@pytest.mark.parametrize(("variables", "share"), [(OLDEST, 3), (SANDYBRIDGE, 0), (HASWELL, 0), (SKYLAKE_X, 0)])
@pytest.mark.slow("more of what the oldest processor's settings show, in plain Python")
def test_bits_do_not_depend_on_libraries(variables, share, plain, tmp_path):
    if variables is SKYLAKE_X and "v4" not in processor.description():
        pytest.skip("this processor cannot run code for AVX-512")
    given, expected = plain(share)
    found = elsewhere(tmp_path, given, CASTER_JIT="0", **variables)
    if variables is OLDEST:
        assert_libraries_differ(found, expected)
    assert_ours_alike(found, expected, f"{variables} against this machine")


def assert_libraries_differ(found, expected):
    """Or the variables had no effect, and the comparison no meaning."""
    if "v4" in processor.description():
        for name in LIBRARIES:
            assert not np.array_equal(found[name], expected[name]), name


@pytest.mark.skipif(not X86, reason="the features and the targets are those of x86-64")
def test_bits_are_those_of_the_oldest_processor(plain, tmp_path):
    """Its libraries and its machine code at once; the tests beside this one vary one of them."""
    given, expected = plain(0)
    oldest = OLDEST | {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    found = elsewhere(tmp_path, given, CASTER_JIT="1", **oldest)
    assert found["compiled"]
    assert_libraries_differ(found, expected)
    assert_ours_alike(found, expected, "the oldest processor against this machine")


@pytest.mark.skipif(not X86, reason="the targets are those of x86-64")
@pytest.mark.parametrize("target", NUMBA_TARGETS)
@pytest.mark.slow("compiles all kernels for another processor")
def test_bits_do_not_depend_on_what_numba_compiles_for(target, plain, tmp_path):
    given, expected = plain(3)
    found = elsewhere(tmp_path, given, CASTER_JIT="1", NUMBA_CPU_NAME=target, NUMBA_CPU_FEATURES="")
    assert found["compiled"]
    assert_ours_alike(found, expected, f"Numba for {target} against plain Python")


def test_a_number_of_a_blas_would_be_found(plain):
    _, found = plain(0)
    key = next(key for key in found if key.endswith("as_given vertices"))
    with pytest.raises(AssertionError, match="vertices"):
        assert_ours_alike(found | {key: found["BLAS"]}, found, "planted")

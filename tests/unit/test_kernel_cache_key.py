"""The cache folder of kernels changes its name with any byte of any source, and with whatever makes machine code."""

import os
import random
import shutil

import pytest

from caster.jit import kernel_cache, machine_code
from caster.jit.kernel_cache import COMPILED, PACKAGE, WITHOUT_KERNELS, compiler_version, source_hash

BLOCK = 4096  # bytes; a hash of only the first block of each file passed the tests once


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """A copy of the package, to edit."""
    folder = tmp_path_factory.mktemp("copy") / PACKAGE.name
    shutil.copytree(PACKAGE, folder, ignore=shutil.ignore_patterns("__pycache__", *WITHOUT_KERNELS))
    return folder


def unchanged(copy, random) -> list[str]:
    """The bytes that may change without the hash: the ends of every source, and some between of the largest."""
    sources = sorted(copy.rglob("*.py"), key=lambda path: -path.stat().st_size)
    assert len(sources) > 50 and sources[0].stat().st_size > 3 * BLOCK
    known, found = source_hash("1"), []
    for place, path in enumerate(sources):
        data = path.read_bytes()
        middle = [random.randrange(len(data)) for _ in range(8)] if place < 12 else []
        for at in sorted({0, len(data) - 1, *middle}) if data else ():
            path.write_bytes(data[:at] + bytes([data[at] ^ 1 << random.randrange(8)]) + data[at + 1 :])
            if source_hash("1") == known:
                found.append(f"{path.relative_to(copy)}:{at}")
        path.write_bytes(data)
    assert source_hash("1") == known
    return found


def test_any_byte_of_any_source_is_part_of_the_key(copy, monkeypatch):
    monkeypatch.setattr(kernel_cache, "PACKAGE", copy)
    assert unchanged(copy, random.Random(1)) == []


@pytest.mark.parametrize(
    "digest_of",
    [
        lambda data: data[:BLOCK],
        lambda data: data.strip(),
        lambda data: bytes(len(data)),
        lambda data: b"".join(sorted(data.splitlines()[:100])),
    ],
    ids=["first block", "stripped", "size", "first lines"],
)
@pytest.mark.slow("each tries every source file", keep=1)
def test_a_digest_that_leaves_out_a_part_is_found(copy, monkeypatch, digest_of):
    class Planted(type(copy)):
        def read_bytes(self):
            return digest_of(super().read_bytes())

    monkeypatch.setattr(kernel_cache, "PACKAGE", Planted(copy))
    assert unchanged(copy, random.Random(1))


def test_names_borders_and_new_files_are_part_of_the_key(copy, monkeypatch):
    """The same bytes under another name, or divided between two files elsewhere, are another source."""
    monkeypatch.setattr(kernel_cache, "PACKAGE", copy)
    known, new = source_hash("1"), copy / "kernels" / "new.py"
    hashes = {known}
    for content in (b"", b"x"):
        new.write_bytes(content)
        hashes.add(source_hash("1"))
    hashes.add(source_hash("2"))
    new = new.rename(new.with_name("newer.py"))
    hashes.add(source_hash("1"))
    new.unlink()
    assert len(hashes) == 5 and source_hash("1") == known


def test_no_source_outside_of_the_key_has_kernels():
    for folder in WITHOUT_KERNELS:
        for path in (PACKAGE / folder).rglob("*.py"):
            lines = path.read_text(encoding="utf-8").splitlines()
            assert not [line for line in lines if line.lstrip().startswith("@") and "kernel" in line], path


@pytest.mark.skipif(not COMPILED, reason="without Numba nothing is compiled")
@pytest.mark.parametrize("library", kernel_cache.COMPILERS)
def test_another_version_of_the_compiler_is_another_key(library, tmp_path, monkeypatch):
    before, find = compiler_version(), kernel_cache.find_spec
    (tmp_path / "_version.py").write_text("version = 'another'")

    class Spec:
        origin = str(tmp_path / "__init__.py")

    monkeypatch.setattr(kernel_cache, "find_spec", lambda name: Spec if name == library else find(name))
    assert compiler_version() != before and source_hash(compiler_version()) != source_hash(before)


@pytest.mark.skipif(not COMPILED, reason="without Numba nothing is compiled")
def test_processor_versions_and_settings_are_part_of_the_key(monkeypatch):
    """Each alone gives another description of the target, which the name of every kernel's file is made of."""
    import llvmlite.binding as llvm

    describe = machine_code.target_description.__wrapped__
    found = [describe()]
    for place, name, value in (
        (llvm, "get_host_cpu_name", lambda: "another"),
        (llvm, "get_host_cpu_features", lambda: type("Features", (), {"flatten": lambda self: "+another"})()),
        (machine_code.np, "__version__", "another"),
        (machine_code.platform, "python_version", lambda: "another"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(place, name, value)
            found.append(describe())
    for name in ("NUMBA_OPT", "NUMBA_CPU_NAME", "NUMBA_BOUNDSCHECK"):
        with monkeypatch.context() as patch:
            patch.setenv(name, "0" if os.environ.get(name) != "0" else "1")
            found.append(describe())
    assert len(set(found)) == len(found) == 8

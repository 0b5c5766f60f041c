""".ci/wheel_with_kernels.py: what goes into the wheel, its list of files, and which levels are built."""

import base64
import csv
import hashlib
import zipfile

import pytest
import wheel_with_kernels

INFO = "ray_reference-0.1.0.dist-info"
PURE = "ray_reference-0.1.0-py3-none-any.whl"


@pytest.fixture
def unpacked(tmp_path):
    tree = tmp_path / "tree"
    for name, text in {
        "caster/__init__.py": "",
        f"{wheel_with_kernels.FOLDER}/load-caster_1.o": "object code",
        f"{INFO}/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{INFO}/RECORD": "caster/__init__.py,sha256=stale,1\n",
    }.items():
        path = tree / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tree


def test_the_wheel_lists_each_file_with_its_digest_and_is_of_this_platform(unpacked, tmp_path):
    wheel = wheel_with_kernels.write_wheel(unpacked, PURE, tmp_path / "dist")
    assert wheel.name == f"ray_reference-0.1.0-{wheel_with_kernels.TAG}.whl"
    with zipfile.ZipFile(wheel) as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
    about = content[f"{INFO}/WHEEL"].decode()
    assert "Root-Is-Purelib: false" in about and f"Tag: {wheel_with_kernels.TAG}" in about
    listed = {row[0]: row[1:] for row in csv.reader(content[f"{INFO}/RECORD"].decode().splitlines())}
    assert listed.keys() == content.keys() and listed.pop(f"{INFO}/RECORD") == ["", ""]
    for name, (digest, size) in listed.items():
        found = base64.urlsafe_b64encode(hashlib.sha256(content[name]).digest()).decode().rstrip("=")
        assert (digest, size) == (f"sha256={found}", str(len(content[name]))), name


def test_the_same_files_make_the_same_wheel(unpacked, tmp_path):
    first, second = (wheel_with_kernels.write_wheel(unpacked, PURE, tmp_path / name) for name in "ab")
    assert first.read_bytes() == second.read_bytes()

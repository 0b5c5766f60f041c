"""A wheel that brings object code of all kernels, so that an installed `caster` renders at once.

    python .ci/wheel_with_kernels.py [--out dist]

`make wheel` runs it, in some minutes. The pure wheel of this tree is unpacked, `caster doctor --warm` compiles its
kernels for x86-64-v3 (caster/jit/machine_code.py:PORTABLE), and their object code goes into caster/jit/object_code.
Sources without a compiler make the same wheel but for that folder, and `pip install .` keeps making that one.
"""

import argparse
import base64
import hashlib
import os
import platform
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from caster.jit.machine_code import PORTABLE, portable_settings, runs_portable_code

ROOT = Path(__file__).resolve().parents[1]
FOLDER = "caster/jit/object_code"
TAG = f"py3-none-linux_{platform.machine()}"
EPOCH = (1980, 1, 1, 0, 0, 0)  # the time of every file, so that the same files make the same wheel


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "dist")
    args = parser.parse_args()
    if not runs_portable_code():  # the kernels are called once when they are compiled
        sys.exit(f"this processor does not run code for {PORTABLE}")
    with tempfile.TemporaryDirectory() as name:
        pure = build_pure_wheel(Path(name) / "pure")
        tree = Path(name) / "tree"
        with zipfile.ZipFile(pure) as archive:
            archive.extractall(tree)
        add_object_code(tree, Path(name) / "home")
        print(write_wheel(tree, pure.name, args.out))


def build_pure_wheel(folder: Path) -> Path:
    """The wheel that `pip install .` makes."""
    words = ["-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", str(folder), str(ROOT)]
    subprocess.run([sys.executable, *words], check=True)
    (wheel,) = folder.glob("*.whl")
    return wheel


def add_object_code(tree: Path, home: Path) -> None:
    """Compile the kernels of an unpacked wheel, and copy them into it."""
    home.mkdir()
    dropped = ("NUMBA_", "CASTER_", "PYTHON")
    environment = {name: value for name, value in os.environ.items() if not name.startswith(dropped)}
    environment |= {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1", "PYTHONHASHSEED": "0"}
    environment |= portable_settings() | {"XDG_CACHE_HOME": str(home)}
    subprocess.run([sys.executable, "-P", "-m", "caster", "doctor", "--warm"], env=environment, check=True)
    files = sorted(home.rglob("*.o"))
    (tree / FOLDER).mkdir(parents=True)
    for file in files:
        (tree / FOLDER / file.name).write_bytes(file.read_bytes())
    print(f"{PORTABLE}: {len(files)} kernels, {sum(file.stat().st_size for file in files) / 1e6:.1f} MB")


def write_wheel(tree: Path, pure_name: str, out: Path) -> Path:
    """The tree as a wheel of this platform; what its RECORD has is worked out anew."""
    (info,) = tree.glob("*.dist-info")
    about = info / "WHEEL"
    text = about.read_text().replace("Root-Is-Purelib: true", "Root-Is-Purelib: false")
    about.write_text(text.replace("Tag: py3-none-any", f"Tag: {TAG}"))
    record = info / "RECORD"
    record.unlink()
    files = sorted(path for path in tree.rglob("*") if path.is_file())
    lines = [f"{path.relative_to(tree).as_posix()},{digest(path)},{path.stat().st_size}" for path in files]
    record.write_text("\n".join([*lines, f"{record.relative_to(tree).as_posix()},,"]) + "\n")
    out.mkdir(parents=True, exist_ok=True)
    wheel = out / pure_name.replace("py3-none-any", TAG)
    with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for path in [*files, record]:
            entry = zipfile.ZipInfo(path.relative_to(tree).as_posix(), EPOCH)
            entry.external_attr = 0o100644 << 16
            archive.writestr(entry, path.read_bytes(), zipfile.ZIP_DEFLATED, 9)
    return wheel


def digest(path: Path) -> str:
    """SHA-256 as RECORD writes it."""
    found = base64.urlsafe_b64encode(hashlib.sha256(path.read_bytes()).digest())
    return f"sha256={found.rstrip(b'=').decode()}"


if __name__ == "__main__":
    main()

"""A copy of both packages in which a few lines are other than here, and the judge run from it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("caster", "mitsuba_ref")
DEADLINE = 120.0  # seconds; plain Python needs one to four for a film of 24 x 20 pixels


def copy_tree(folder: Path) -> Path:
    """caster/ and mitsuba_ref/ side by side in `folder`."""
    for package in PACKAGES:
        shutil.copytree(ROOT / package, folder / package)
    return folder


def edit(tree: Path, file: str, old: str, new: str) -> None:
    """Replace text that is there exactly once, so that an edit which no longer fits is an error."""
    path = tree / file
    source = path.read_text(encoding="utf-8")
    assert source.count(old) == 1, f"{file}: expected once, found {source.count(old)} times: {old!r}"
    path.write_text(source.replace(old, new), encoding="utf-8")


def run(tree: Path, *argv: str, module: str = "mitsuba_ref") -> subprocess.CompletedProcess[str]:
    """A command of the copy, without the compiler: a kernel that changed would have to be compiled anew."""
    words = [sys.executable, "-P", "-m", module, *argv]
    environment = {**os.environ, "PYTHONPATH": str(tree), "CASTER_JIT": "0"}
    return subprocess.run(
        words, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=DEADLINE, check=False
    )

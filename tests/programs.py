"""Runs the programs of docs/programs, and other Python in processes of its own."""

import contextlib
import io
import os
import runpy
import subprocess
import sys
import warnings
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "programs"
MAX_LINES = 12  # without the comment on top, which says what the program does


def python(*words: str | Path, cwd: Path = ROOT, **variables: str) -> subprocess.CompletedProcess[str]:
    """A process of this interpreter that finds this tree and has these words after its name."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)} | variables
    return subprocess.run(
        [sys.executable, *words], cwd=cwd, env=environment, capture_output=True, text=True, timeout=300
    )


def printed_by(*words: str | Path, cwd: Path = ROOT, **variables: str) -> str:
    """What such a process prints; it has to end with exit code 0."""
    done = python(*words, cwd=cwd, **variables)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def install(folder: Path, name: str, **modules: str) -> None:
    """A distribution in `folder`, which names modules as the plug-ins of packages."""
    about = folder / f"{name}-1.0.dist-info"
    about.mkdir(exist_ok=True)
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    groups = (f"[{package}.plugins]\n{name} = {module}\n" for package, module in modules.items())
    (about / "entry_points.txt").write_text("".join(groups))


def run_program(path: Path, folder: Path) -> str:
    """What the program prints in `folder`; it has to end with exit code 0."""
    if "import pytest" in path.read_text():
        places = os.pathsep.join([str(ROOT), str(folder)])
        return printed_by("-m", "pytest", "-q", "-p", "no:cacheprovider", path, cwd=folder, PYTHONPATH=places)
    for file in folder.glob("*.py"):
        sys.modules.pop(file.stem, None)  # another test's, of the same name
    modules, out = set(sys.modules), io.StringIO()
    sys.path.insert(0, str(folder))
    try:
        with contextlib.chdir(folder), contextlib.redirect_stdout(out), warnings.catch_warnings(action="default"):
            runpy.run_path(str(path), run_name="__main__")
    except SystemExit as end:
        assert not end.code, f"{path.name}: {end.code}\n{out.getvalue()}"
    finally:
        sys.path.remove(str(folder))
        for name in set(sys.modules) - modules:
            if str(getattr(sys.modules[name], "__file__", "")).startswith(str(folder)):
                del sys.modules[name]
    return out.getvalue()

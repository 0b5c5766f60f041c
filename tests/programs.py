"""The programs of docs/programs: runs them, and has mypy look for a misspelt keyword in each."""

import ast
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "programs"
PACKAGES = ("caster", "mitsuba_ref")
MAX_LINES = 12  # without the comment on top, which says what the program does


def run_program(path: Path, folder: Path) -> str:
    """What the program prints in `folder`; it has to end with exit code 0."""
    command = ["-m", "pytest", "-q", "-p", "no:cacheprovider"] if "import pytest" in path.read_text() else []
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(folder)])}
    words = [sys.executable, *command, str(path)]
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, f"{path.name}:\n{done.stdout}{done.stderr}"
    return done.stdout


def check_length(path: Path) -> None:
    comment, *lines = path.read_text().splitlines()
    assert comment.startswith("# ") and len(lines) <= MAX_LINES, path


def misspelt(source: str) -> str:
    """The program with the first keyword of a call of one of the packages misspelt."""
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call) and node.keywords]
    keywords = [call.keywords[0] for call in calls if ast.unparse(call.func).partition(".")[0] in PACKAGES]
    first = min(keywords, key=lambda keyword: keyword.lineno)
    lines = source.splitlines(keepends=True)
    before, after = (lines[first.lineno - 1][part] for part in (slice(first.col_offset), slice(first.col_offset, None)))
    lines[first.lineno - 1] = f"{before}x{after}"
    return "".join(lines)


def check_types(paths: Iterable[Path], folder: Path) -> None:
    """mypy finds nothing in the programs, and one error where a keyword is misspelt. folder: for the copies."""
    names = []
    for path in paths:
        names += [path.stem, f"misspelt_{path.stem}"]
        (folder / f"{names[-2]}.py").write_text(path.read_text())
        (folder / f"{names[-1]}.py").write_text(misspelt(path.read_text()))
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--cache-dir",
        str(ROOT / ".mypy_cache"),
        *(f"{name}.py" for name in names),
    ]
    environment = os.environ | {"MYPYPATH": os.pathsep.join([str(ROOT), str(ROOT / "mitsuba_ref/starters/python")])}
    found = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True).stdout
    errors = Counter(re.findall(r"^(\w+)\.py:\d+: error", found, re.MULTILINE))
    assert errors == Counter(name for name in names if name.startswith("misspelt_")), found

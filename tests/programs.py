"""Runs the programs of docs/programs."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "programs"
MAX_LINES = 12  # without the comment on top, which says what the program does


def run_program(path: Path, folder: Path) -> str:
    """What the program prints in `folder`; it has to end with exit code 0."""
    command = ["-m", "pytest", "-q", "-p", "no:cacheprovider"] if "import pytest" in path.read_text() else []
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(folder)])}
    words = [sys.executable, *command, str(path)]
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, f"{path.name}:\n{done.stdout}{done.stderr}"
    return done.stdout

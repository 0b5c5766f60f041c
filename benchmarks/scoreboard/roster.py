"""The casters of casters.toml: what is installed for each, and the program that answers rays."""

import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from caster.system.terminal import printable

HERE = Path(__file__).parent
STARTERS = HERE.parents[1] / "mitsuba_ref" / "starters"


class NotInstalledError(Exception):
    """A caster that cannot run here, and why."""


@dataclass(frozen=True)
class Entry:
    """One caster, as casters.toml describes it."""

    name: str
    title: str
    file: str
    calls: str
    precision: str
    why: str
    limits: bool = False
    rays: int | None = None  # of each setting, for slow ones; None: RAYS of the family
    pip: Sequence[str] = ()
    npm: Sequence[str] = ()
    debian: Sequence[str] = ()
    flags: Sequence[str] = ()
    own_environment: bool = False  # its packages exclude those of others
    environment: dict[str, str] = field(default_factory=dict)  # variables of its process
    by_design: dict[str, str] = field(default_factory=dict)  # by column

    @property
    def path(self) -> Path:
        return HERE / "casters" / self.file


def entries(file: Path = HERE / "casters.toml") -> list[Entry]:
    return [Entry(name, **fields) for name, fields in tomllib.loads(file.read_text()).items()]


def command(entry: Entry, build: Path) -> str:
    """Install or compile what a caster needs into `build`; returns the program. Raises NotInstalledError."""
    if entry.path.suffix == ".py":
        python = installed(entry, build) if entry.pip else Path(sys.executable)
        variables = [f"{name}={value}" for name, value in entry.environment.items()]
        words = ["env", *variables, python, HERE / "serve.py", entry.path, entry.precision]
    elif entry.path.suffix == ".mjs":
        folder = build / "npm"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "package.json").write_text("{}")
        run("npm", "install", "--silent", "--prefix", folder, "--no-save", *every_package("npm"))
        for each in (entry.path, STARTERS / "javascript" / "rays_and_hits.js"):
            shutil.copy(each, folder)
        words = ["node", folder / entry.file]
    else:
        compiler = {".c": ["cc", "-std=gnu99"], ".cpp": ["c++", "-std=c++17"]}[entry.path.suffix]
        words = [build / entry.name]
        run(*compiler, "-O2", "-o", *words, entry.path, "-I", STARTERS / "c", *entry.flags)
    return shlex.join(map(str, words))


def every_package(kind: str) -> list[str]:
    return sorted({package for entry in entries() for package in getattr(entry, kind)})


def installed(entry: Entry, build: Path) -> Path:
    """The interpreter of a virtual environment with the entry's packages. Raises NotInstalledError."""
    python = build / ("venv-" + entry.name if entry.own_environment else "venv") / "bin" / "python"
    if not python.exists():
        run(sys.executable, "-m", "venv", python.parents[1])
    run(python, "-m", "pip", "install", "-q", "--disable-pip-version-check", *entry.pip)
    return python


def version(entry: Entry, build: Path) -> str:
    """Versions of the packages, as their package managers name them."""
    found = [*entry.pip, *entry.npm]
    for package in entry.debian:
        found.append(f"{package} {run('dpkg-query', '-W', '-f', '${Version}', package)}")
    return ", ".join(each.replace("==", " ").lstrip("@").replace("@", " ") for each in found) or "of this tree"


def run(*words: object) -> str:
    """The output of a program. Raises NotInstalledError with its last line."""
    try:
        done = subprocess.run([*map(str, words)], capture_output=True, text=True, check=False)
    except OSError as error:
        raise NotInstalledError(f"{words[0]}: {error.strerror}") from error
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if "error" in line.lower()] or done.stderr.splitlines()
        raise NotInstalledError(printable(lines[0] if lines else f"{words[0]} ended with {done.returncode}")[:200])
    return done.stdout

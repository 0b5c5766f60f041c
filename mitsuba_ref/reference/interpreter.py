"""The Python interpreter that runs the reference: this one, or another that has a Mitsuba of its own (--mitsuba).

The choice is an environment variable, so that it holds for all processes of a run.
"""

import contextlib
import hashlib
import json
import os
import re
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from caster.description.errors import SceneError, error_prefix
from mitsuba_ref.reference.subprocess_runner import import_path, run

# The options --mitsuba, --variant and --as-in-file, as environment variables.
PYTHON_VARIABLE, VARIANT_VARIABLE = "MITSUBA_REF_PYTHON", "MITSUBA_REF_VARIANT"
AS_IN_FILE_VARIABLE = "MITSUBA_REF_AS_IN_FILE"
LEAST_PYTHON, LEAST_MITSUBA = "3.11", "3.6"  # of our own code; the first Mitsuba with robust intersections
BINARIES = (".so", ".dylib")
ANSWER_SECONDS = 60.0  # for an interpreter to describe itself; it takes a third of one

# Prints the description after a mark, in the syntax of any Python. The empty entry is the current folder.
DESCRIBE = """
import sys
sys.path[:] = [place for place in sys.path if place]
import json, os
found = {"python": "%d.%d.%d" % sys.version_info[:3]}
try:
    import numpy, drjit, mitsuba
    try:
        version = mitsuba.__version__
    except ImportError:  # 3.5 has none before a variant is set
        from importlib.metadata import version as version_of
        version = version_of("mitsuba")
    found["versions"] = {"mitsuba": version, "drjit": drjit.__version__}
    found["folders"] = [os.path.dirname(module.__file__) for module in (mitsuba, drjit)]
    found["variants"] = list(mitsuba.variants())
except Exception as problem:
    found["problem"] = str(problem).partition("\\n")[0]
print("DESCRIPTION" + json.dumps(found))
"""


@dataclass(frozen=True)
class Installation:
    """The Mitsuba that an interpreter imports."""

    versions: dict[str, str]  # mitsuba, drjit
    variants: tuple[str, ...]  # that it was built with
    build: str  # a hash of its libraries' names, sizes and times: a new build may have the same version


def interpreter() -> str:
    """The path of the interpreter that runs Mitsuba, or the given name where there is no such program."""
    given = os.environ.get(PYTHON_VARIABLE)
    program = shutil.which(given) if given else sys.executable
    return os.path.abspath(program) if program else str(given)


@contextlib.contextmanager
def chosen(python: str) -> Iterator[None]:
    """A context in which that interpreter runs Mitsuba; for one thread."""
    before = os.environ.get(PYTHON_VARIABLE, "")
    os.environ[PYTHON_VARIABLE] = python
    try:
        yield
    finally:
        os.environ[PYTHON_VARIABLE] = before


def installation() -> Installation:
    """The Mitsuba of the chosen interpreter. Raises SceneError for one that cannot be used."""
    return installation_of(interpreter())


@cache
def installation_of(python: str) -> Installation:
    with error_prefix("--mitsuba", python):
        if shutil.which(python) is None:
            hint = f"; did you mean {python}/bin/python?" if os.path.isdir(python) else ""
            raise SceneError(f"is no program{hint}")
        try:
            end = run([python, "-c", DESCRIBE], ANSWER_SECONDS, {"PYTHONPATH": import_path()})
        except OSError as error:
            raise SceneError(f"cannot be started: {error.strerror}") from None
        _, mark, description = end.output.rpartition("DESCRIPTION")
        if not mark or end.code != 0:
            raise SceneError(f"does not answer as a Python does: {f'{end.exit} {end.headline}'.strip()}")
        found = json.loads(description)
        if _numbers(found["python"]) < _numbers(LEAST_PYTHON):
            raise SceneError(f"is Python {found['python']}; expected {LEAST_PYTHON} or newer")
        if "problem" in found:
            way_out = f"{python} -m pip install numpy 'mitsuba>={LEAST_MITSUBA}'"
            raise SceneError(f"cannot import Mitsuba and NumPy: {found['problem']} ({way_out})")
        mitsuba = found["versions"]["mitsuba"]
        if _numbers(mitsuba) < _numbers(LEAST_MITSUBA):
            raise SceneError(
                f"has Mitsuba {mitsuba}; expected {LEAST_MITSUBA} or later, which has robust intersections"
            )
    libraries = [path for folder in found["folders"] for path in sorted(Path(folder).rglob("*"))]
    stamps = [file_stamp(path) for path in libraries if path.suffix in BINARIES]
    build = hashlib.sha256("\n".join(stamps).encode()).hexdigest()
    return Installation(found["versions"], tuple(found["variants"]), build)


def file_stamp(path: str | Path) -> str:
    """The path with the size and the time of its file, for a key."""
    try:
        status = os.stat(path)
    except OSError:
        return f"{path} missing"
    return f"{path} {status.st_size} {status.st_mtime_ns}"


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(number) for number in re.findall(r"\d+", version)[:2])


def as_in_file() -> bool:
    """Whether Embree's robust mode is used only where the file of the scene requests it; else it always is."""
    return os.environ.get(AS_IN_FILE_VARIABLE, "") not in ("", "0")

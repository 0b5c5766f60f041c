"""Commands of a tree, perhaps an edited copy, each in a fork of one process that has the libraries loaded already.

To start Python, to load the libraries and to start Mitsuba takes three times as long as to judge a small film.
So the process loads the libraries, and no more: what is under test is loaded by each fork, from its own tree. A
process that is given a tree loads it as well: it forks for commands of this tree alone, which nobody may edit. And
with a memory, Mitsuba is asked once about the same rays through the same scene; a fault that alters either has it
asked anew.

As a program it reads orders, a line of JSON each, and answers each with a line: the exit code.
"""

import hashlib
import importlib
import json
import os
import runpy
import sys
from pathlib import Path
from typing import Any

PACKAGES = ("caster", "mitsuba_ref")
LIBRARIES = ("numpy.ma", "numpy.random", "numpy.typing", "pydantic.main", "pydantic.json_schema", "tree_sitter")
COMMANDS = (  # what they load
    "mitsuba_ref.runner.validation_run",
    "mitsuba_ref.probe.pixel",
    "mitsuba_ref.exr_compare.two_files",
    "caster.rendering.images",
    "caster.image.channels",
)
STANDARD = ("concurrent.futures.thread", "importlib.metadata", "tomllib", "xml.etree.ElementTree", "zoneinfo")


def serve(home: str | None = None) -> None:
    """Obey until nobody gives orders any more; home: a tree to load, whose commands alone are run then."""
    for name in (*LIBRARIES, *STANDARD):
        importlib.import_module(name)
    loaded = [name for name in sys.modules if name.partition(".")[0] in PACKAGES]
    assert not loaded, f"a fork would not take these from its tree: {loaded}"
    if home:
        sys.path.insert(0, home)
        for name in COMMANDS:
            importlib.import_module(name)
    while order := sys.stdin.readline():
        child = os.fork()
        if child == 0:
            return obey(**json.loads(order))
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


def obey(tree: str, module: str, argv: list[str], out: str, err: str, memory: str | None, without: list[str]) -> Any:
    """What `python -P -m module argv` does with PYTHONPATH=tree; its words go to the files out and err.

    without: names of checks of our caster that `validate` shall pass over.
    """
    new = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
    for number, file, flags in ((0, os.devnull, os.O_RDONLY), (1, out, new), (2, err, new)):
        os.dup2(os.open(file, flags), number)
    os.environ["PYTHONPATH"] = tree
    sys.path.insert(0, tree)
    sys.argv = [module, *argv]
    if module == "pytest":  # it warns of a plugin that is imported before it
        return runpy.run_module(module, run_name="__main__", alter_sys=True)
    if memory:
        ask_once(Path(memory))
    for name in without:
        pass_over(name)
    for name in PACKAGES:
        assert Path(str(importlib.import_module(name).__file__)).is_relative_to(tree)
    runpy.run_module(module, run_name="__main__", alter_sys=True)


def pass_over(name: str) -> None:
    """A check is not made."""
    from mitsuba_ref.judge import checks

    assert name in {check.name for check in checks.all_checks()}, name
    del checks._registered[name]
    checks.all_checks.cache_clear()


def ask_once(memory: Path) -> None:
    """Answers of Mitsuba are kept in a folder, and taken from there where all that it would be given is the same."""
    from mitsuba_ref.reference import variants
    from mitsuba_ref.reference.messages import TraceResponse
    from mitsuba_ref.reference.mitsuba_process import ResidentSession

    put = ResidentSession.send

    def put_once(session: Any, job: Any, timeout: float) -> Any:
        place = memory / everything_given(job, variants.environment_for(job.variant))
        if place.exists():  # put there whole
            return TraceResponse.from_bytes(place.read_bytes(), len(job.o))
        answer = put(session, job, timeout)
        if isinstance(answer, TraceResponse):
            keep(answer, place)
        return answer

    ResidentSession.send = put_once  # type: ignore[method-assign]


def everything_given(job: Any, settings: dict[str, str]) -> str:
    """A hash of the settings, the rays and the files of the scenes; every file of their folders counts."""
    told = hashlib.sha256()
    told.update(
        repr((job.xml.name, job.variant, job.lights, job.sensor, job.strict, sorted(settings.items()))).encode()
    )
    for name in job.ROWS:
        array = getattr(job, name)
        told.update(f"\n{name} {array.dtype} {array.shape}\n".encode() + array.tobytes())
    for path in sorted(path for path in job.xml.parent.rglob("*") if path.is_file()):
        content = path.read_bytes()
        told.update(f"\n{path.relative_to(job.xml.parent)} {len(content)}\n".encode() + content)
    return told.hexdigest()


def keep(answer: Any, place: Path) -> None:
    """Whole or not at all: two processes may keep the same answer at the same time."""
    part = place.with_name(f"{place.name}.{os.getpid()}")
    part.write_bytes(answer.to_bytes())
    part.rename(place)


if __name__ == "__main__":
    serve(*sys.argv[1:])

"""Commands of a tree, which may be an edited copy, each in a fork of one process that has loaded the libraries.

Starting Python, loading the libraries and starting Mitsuba takes three times as long as judging a small film. The
process loads the libraries and nothing else: each fork loads the code under test from its own tree. A process that is
given a tree loads that as well, and forks only for commands of this tree, which must not be edited. With a memory,
`validate` and `judge` store Mitsuba's answers there; a fault that alters rays or scene has it asked again.

As a program it reads orders, a line of JSON each, and answers each with a line that holds the exit code.
"""

import importlib
import json
import os
import resource
import runpy
import sys
from pathlib import Path
from typing import Any

PACKAGES = ("caster", "mitsuba_ref")
LIBRARIES = (
    *("numpy.ma", "numpy.random", "numpy.typing", "pydantic.main", "pydantic.json_schema", "tree_sitter"),
    *("hypothesis", "pytest"),
)
COMMANDS = (  # what they load
    "mitsuba_ref.runner.validation_run",
    "mitsuba_ref.probe.pixel",
    "mitsuba_ref.exr_compare.two_files",
    "caster.rendering.images",
    "caster.image.channels",
)
STANDARD = ("concurrent.futures.thread", "importlib.metadata", "tomllib", "xml.etree.ElementTree", "zoneinfo")


def serve(home: str | None = None) -> None:
    """Run orders until stdin ends. home: a tree to load; only its commands are run then."""
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


MEMORY_LIMIT = 6 << 30  # bytes of address space of a command with a limit: an edit may allocate for ever


def obey(
    tree: str,
    module: str,
    argv: list[str],
    out: str,
    err: str,
    memory: str | None,
    without: list[str],
    environment: dict[str, str],
    folder: str,
    limit: float | None,
) -> Any:
    """Do what `python -P -m module argv` does in a folder with PYTHONPATH=tree; its output goes to the files out, err.

    without: names of checks of our caster that `validate` leaves out. limit: CPU seconds, after which it is killed.
    """
    if limit:
        resource.setrlimit(resource.RLIMIT_CPU, (int(limit) + 1, int(limit) + 2))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
    os.chdir(folder)
    os.environ.update(environment)
    new = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
    for number, file, flags in ((0, os.devnull, os.O_RDONLY), (1, out, new), (2, err, new)):
        os.dup2(os.open(file, flags), number)
    os.environ["PYTHONPATH"] = tree
    sys.path[:0] = tree.split(os.pathsep)
    sys.argv = [module, *argv]
    if module == "pytest":  # it loads the tree, and warns of libraries that are loaded before it
        sys.argv += ["-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning"]
        return runpy.run_module(module, run_name="__main__", alter_sys=True)
    if memory and argv[:1] in (["validate"], ["judge"]):
        reuse_answers(memory)
    for name in without:
        pass_over(name)
    for name in PACKAGES:
        assert Path(str(importlib.import_module(name).__file__)).is_relative_to(tree)
    runpy.run_module(module, run_name="__main__", alter_sys=True)


def pass_over(name: str) -> None:
    """Leave out a check."""
    from mitsuba_ref.judge import checks

    assert name in {check.name for check in checks.all_checks()}, name
    del checks._registered[name]
    checks.all_checks.cache_clear()


def reuse_answers(memory: str) -> None:
    """Have `validate` and `judge` of this process store Mitsuba's answers in a folder, but no verdicts."""
    from mitsuba_ref.runner import many_scenes

    os.environ["MITSUBA_REF_STORE"] = memory
    many_scenes.local_store = lambda: None  # type: ignore[assignment]


if __name__ == "__main__":
    serve(*sys.argv[1:])

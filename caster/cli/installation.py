"""`caster doctor`: the packages found on this machine, the use of each missing one, and kernels compiled ahead."""

import importlib
import importlib.metadata
import json
import os
import platform
import re
from argparse import Namespace
from collections.abc import Sequence
from typing import NamedTuple

from caster.cli.shared_arguments import Adder, InputPath
from caster.system import processor
from caster.system.process import FILE, OK
from caster.system.terminal import folded

__all__ = ["Finding", "print_findings"]


class Package(NamedTuple):
    """A required or optional Python package."""

    distribution: str
    module: str
    least: str  # the oldest version that will do
    adds: str
    needed: bool = True


PACKAGES = (
    Package("numpy", "numpy", "2.0", "every array"),
    Package("numba", "numba", "0.68", "speed: compiled kernels, the same bits", needed=False),
    Package("OpenEXR", "OpenEXR", "3.4.9", "images in and out"),
    Package("pillow", "PIL", "10.1", "PNG and TGA images: previews, caster 6837", needed=False),
    Package("pydantic", "pydantic", "2.7", "scene descriptions and their checks"),
    Package("rich", "rich", "13.7", "progress bars on a terminal"),
    Package("trimesh", "trimesh", "4.6", "mesh files STL, OFF and glTF", needed=False),
    Package("tree-sitter", "tree_sitter", "0.23", "line and column of an error in a scene file"),
    Package("tree-sitter-toml", "tree_sitter_toml", "0.7", "the same in TOML"),
    Package("tree-sitter-json", "tree_sitter_json", "0.24", "the same in JSON"),
)


class Finding(NamedTuple):
    """One line of the report. detail: the version found, or why it cannot be used."""

    name: str
    found: bool
    needed: bool
    detail: str
    adds: str
    way_out: str = ""


def add_arguments(add: Adder) -> None:
    add("--json", bool, "as JSON")
    add(
        "--warm",
        InputPath,
        "compile the kernels that `caster render` would compile at first use, for these scene files; "
        "without any, for all shapes and cameras, which takes minutes",
        metavar="SCENE",
        nargs="*",
    )


def run(args: Namespace) -> int:
    """Print the findings (4 if something needed is missing), or compile kernels. Raises SceneError, FileMissing."""
    return print_findings(report(), args.json) if args.warm is None else warm(args.warm, args.json)


def warm(paths: Sequence[str], as_json: bool) -> int:
    """Compile the kernels of these scene files that are not cached yet, and print how many."""
    from caster.jit.kernel_cache import COMPILED
    from caster.rendering import warm_up
    from caster.scene.files import load_scene
    from caster.system.terminal import report_refused_cache

    if not COMPILED:
        print("kernels: none, as Numba is switched off or not installed")
        return OK
    report_refused_cache()
    done = warm_up.warm_up([load_scene(path) for path in paths] or warm_up.warm_up_scenes())
    text = f"kernels: {done.compiled} compiled, {done.loaded} loaded from the cache"
    print(json.dumps(done._asdict()) if as_json else text)
    return OK


def report() -> list[Finding]:
    """Findings on Python, the processor and every package that the ray caster uses."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    python = f"{platform.python_version()} on {platform.system()} {platform.machine()}, {cores} cores"
    return [
        Finding("Python", True, True, python, "everything"),
        Finding("processor", True, False, processor.description(), "the last bits of Mitsuba's images, not of ours"),
        *map(find_package, PACKAGES),
    ]


def print_findings(findings: Sequence[Finding], as_json: bool) -> int:
    """Print findings as a table or as JSON; 0 if usable, else 4: something needed is missing or cannot be loaded."""
    missing = [finding.name for finding in findings if finding.needed and not finding.found]
    if as_json:
        print(json.dumps({"usable": not missing, "findings": [f._asdict() for f in findings]}, indent=2))
    else:
        width = max(len(finding.name) for finding in findings)
        for finding in findings:
            print(folded(_line(finding, width)))
        verdict = f"Not usable without {', '.join(missing)}." if missing else "Usable: everything needed was found."
        print(f"\n{verdict}")
    return FILE if missing else OK


def _line(finding: Finding, width: int) -> str:
    if finding.found:
        return f"ok       {finding.name:{width}}  {finding.detail}"
    state, use = ("MISSING", "needed for") if finding.needed else ("without", "would add")
    way_out = f" ({finding.way_out})" if finding.way_out else ""
    return f"{state}  {finding.name:{width}}  {finding.detail}; {use} {finding.adds}{way_out}"


def find_package(part: Package) -> Finding:
    """Check one package: installed, new enough, and importable."""
    found = False
    try:
        detail = importlib.metadata.version(part.distribution)
        if _numbers(detail) < _numbers(part.least):
            detail += f" is too old, {part.least} or newer is needed"
        else:
            importlib.import_module(part.module)
            found = True
    except importlib.metadata.PackageNotFoundError:
        detail = "not installed"
    except Exception as error:  # a broken wheel may raise anything
        detail += f" is installed, but does not import: {error}"
    if found and part.module == "numba" and os.environ.get("CASTER_JIT") == "0":
        detail += ", switched off by CASTER_JIT=0"
    way_out = "" if found else f"pip install '{part.distribution}>={part.least}'"
    return Finding(part.distribution, found, part.needed, detail, part.adds, way_out)


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(number) for number in re.findall(r"\d+", version)[:3])

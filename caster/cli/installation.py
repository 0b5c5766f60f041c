"""`caster doctor`: packages found on this machine, what each missing one would add, and kernels compiled ahead."""

from __future__ import annotations

import argparse
import importlib
import importlib.metadata
import json
import os
import platform
import re
from collections.abc import Sequence
from typing import NamedTuple

from caster.cli.shared_arguments import InputPath
from caster.system import processor
from caster.system.process import OK

__all__ = ["Finding", "Package", "exit_code", "find_package", "format_json", "print_findings", "report", "usable"]


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
    Package("pillow", "PIL", "10.1", "PNG and TGA images: previews, sheets, caster 6837", needed=False),
    Package("pydantic", "pydantic", "2.7", "scene descriptions and their checks"),
    Package("rich", "rich", "13.7", "progress bars and tables on a terminal"),
    Package("trimesh", "trimesh", "4.6", "mesh files STL, OFF and glTF", needed=False),
    Package("tree-sitter", "tree_sitter", "0.23", "line and column of an error in a scene file"),
    Package("tree-sitter-toml", "tree_sitter_toml", "0.7", "the same in TOML"),
    Package("tree-sitter-json", "tree_sitter_json", "0.24", "the same in JSON"),
)


class Finding(NamedTuple):
    """The result of one look-up. detail: the version found, or why it cannot be used."""

    name: str
    found: bool
    needed: bool
    detail: str
    adds: str
    way_out: str = ""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="as JSON")
    parser.add_argument(
        "--warm",
        nargs="*",
        metavar="SCENE",
        type=InputPath,
        help="compile the kernels that `caster render` would compile at first use, for these scene files; "
        "without any, for all shapes and cameras, which takes minutes",
    )


def run(args: argparse.Namespace) -> int:
    """Print the findings (4 if something needed is missing), or compile kernels. Raises SceneError, FileMissing."""
    return print_findings(report(), args.json) if args.warm is None else warm(args.warm, args.json)


def warm(paths: Sequence[str], as_json: bool) -> int:
    """Compile the kernels of these scene files that are not cached yet, and print how many."""
    from caster.jit.kernel_cache import COMPILED
    from caster.rendering import warm_up
    from caster.scene.files import load_scene
    from caster.system.terminal import compilation_reported, report_refused_cache

    if not COMPILED:
        print("kernels: none, as Numba is switched off or not installed")
        return OK
    report_refused_cache()
    scenes = [(path, load_scene(path)) for path in paths] if paths else list(warm_up.warm_up_scenes())
    with compilation_reported():
        done = warm_up.warm_up(scenes, lambda name: None)
    if as_json:
        print(json.dumps(done._asdict()))
    elif done.compiled:
        print(f"kernels: {done.compiled} compiled, {done.loaded} loaded from the cache")
    else:
        print(f"kernels: 0 compiled, all {done.loaded} were in the cache")
    return OK


def report() -> list[Finding]:
    """Findings on Python, the processor and every package that the ray caster uses."""
    return [_python(), _processor(), *(find_package(part) for part in PACKAGES)]


def _processor() -> Finding:
    """Reported: images of the caster do not depend on it, last bits of Mitsuba's do."""
    adds = "nothing to images of caster; last bits to those of Mitsuba"
    return Finding("processor", True, False, processor.description(), adds)


def usable(findings: Sequence[Finding]) -> bool:
    """Whether everything needed was found."""
    return all(finding.found for finding in findings if finding.needed)


def exit_code(findings: Sequence[Finding]) -> int:
    """0 when usable, else 4: something needed is missing or cannot be loaded."""
    return 0 if usable(findings) else 4


def print_findings(findings: Sequence[Finding], as_json: bool) -> int:
    """Print findings as a table or as JSON; the exit code they make."""
    print(format_json(findings) if as_json else format_table(findings))
    return exit_code(findings)


def format_table(findings: Sequence[Finding]) -> str:
    """The findings as a table, with a conclusion in the last line."""
    width = max(len(finding.name) for finding in findings)
    return "\n".join([*(_line(finding, width) for finding in findings), "", _verdict(findings)])


def format_json(findings: Sequence[Finding]) -> str:
    """The findings as JSON: {"usable": bool, "findings": [{"name", "found", ...}, ...]}."""
    return json.dumps({"usable": usable(findings), "findings": [f._asdict() for f in findings]}, indent=2)


def find_package(part: Package) -> Finding:
    """Check one package: installed, new enough, and importable."""
    problem, detail = "", "not installed"
    try:
        detail = importlib.metadata.version(part.distribution)
        problem = _problem(part, detail)
    except importlib.metadata.PackageNotFoundError:
        problem = detail
    if not problem and part.module == "numba" and os.environ.get("CASTER_JIT") == "0":
        detail += ", switched off by CASTER_JIT=0"
    way_out = f"pip install '{part.distribution}>={part.least}'" if problem else ""
    return Finding(part.distribution, not problem, part.needed, problem or detail, part.adds, way_out)


def _problem(part: Package, version: str) -> str:
    """Why an installed package cannot be used, or nothing."""
    if _numbers(version) < _numbers(part.least):
        return f"{version} is too old, {part.least} or newer is needed"
    try:
        importlib.import_module(part.module)
    except Exception as error:  # a broken wheel may raise anything
        return f"{version} is installed, but does not import: {error}"
    return ""


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(number) for number in re.findall(r"\d+", version)[:3])


def _python() -> Finding:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    detail = f"{platform.python_version()} on {platform.system()} {platform.machine()}, {cores} cores"
    return Finding("Python", True, True, detail, "everything")


def _line(finding: Finding, width: int) -> str:
    if finding.found:
        return f"ok       {finding.name:{width}}  {finding.detail}"
    state = "MISSING" if finding.needed else "without"
    use = "needed for" if finding.needed else "would add"
    way_out = f" ({finding.way_out})" if finding.way_out else ""
    return f"{state}  {finding.name:{width}}  {finding.detail}; {use} {finding.adds}{way_out}"


def _verdict(findings: Sequence[Finding]) -> str:
    missing = [finding.name for finding in findings if finding.needed and not finding.found]
    return f"Not usable without {', '.join(missing)}." if missing else "Usable: everything needed was found."

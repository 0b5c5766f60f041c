"""`caster doctor`: what this machine has for the ray caster."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

from caster.cli.exit_codes import OK

__all__ = ["HELP", "add_json", "print_findings"]

if TYPE_CHECKING:
    from caster.cli.installation import Finding
    from caster.rendering.warm_up import WarmUpCounts
    from caster.scene.model import Scene

HELP = "say what was found on this machine, and what each missing thing would add"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_json(parser)
    parser.add_argument(
        "--warm",
        nargs="*",
        metavar="SCENE",
        help="compile now what `caster render` would compile when it first needs it, for these scene files; "
        "without any, for all shapes and cameras, which takes minutes",
    )


def add_json(parser: argparse.ArgumentParser) -> None:
    """--json, which the judge's doctor has, too."""
    parser.add_argument("--json", action="store_true", help="as JSON")


def run(args: argparse.Namespace) -> int:
    """Print the findings, 4 when something needed is missing; or compile kernels. Raises SceneError, FileMissing."""
    if args.warm is not None:
        return warm(args.warm, args.json)
    from caster.cli import installation

    return print_findings(installation.report(), args)


def print_findings(findings: Sequence[Finding], args: argparse.Namespace) -> int:
    """Print findings as asked; the exit code they make."""
    from caster.cli import installation

    print(installation.format_json(findings) if args.json else installation.format_table(findings))
    return installation.exit_code(findings)


def warm(paths: Sequence[str], as_json: bool) -> int:
    """Compile what is not in the cache yet, and say how much that was."""
    from caster.cli.progress import CompileProgress, report_refused_cache
    from caster.jit.decorators import COMPILATION_LOG
    from caster.jit.kernel_cache import COMPILED
    from caster.rendering import warm_up

    if not COMPILED:
        print("kernels: none, as Numba is switched off or not installed")
        return OK
    report_refused_cache()
    progress = CompileProgress()
    COMPILATION_LOG.compiling = progress.compiling
    done = warm_up.warm_up(_load_scenes(paths) if paths else warm_up.warm_up_scenes(), progress.begin)
    progress.end()
    print(json.dumps(done._asdict()) if as_json else _warm_summary(done))
    return OK


def _load_scenes(paths: Sequence[str]) -> list[tuple[str, Scene]]:
    from caster.scene.files import load_scene

    return [(path, load_scene(path)) for path in paths]


def _warm_summary(done: WarmUpCounts) -> str:
    if not done.compiled:
        return f"kernels: 0 compiled, all {done.loaded} were in the cache"
    return f"kernels: {done.compiled} compiled, {done.loaded} loaded from the cache"

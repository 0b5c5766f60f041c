"""`caster doctor`: report installed packages, or compile kernels ahead of their first use."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

from caster.cli.exit_codes import OK

if TYPE_CHECKING:
    from caster.rendering.warm_up import WarmUpCounts
    from caster.scene.model import Scene


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="as JSON")
    parser.add_argument(
        "--warm",
        nargs="*",
        metavar="SCENE",
        help="compile the kernels that `caster render` would compile at first use, for these scene files; "
        "without any, for all shapes and cameras, which takes minutes",
    )


def run(args: argparse.Namespace) -> int:
    """Print the findings (4 if something needed is missing), or compile kernels. Raises SceneError, FileMissing."""
    if args.warm is not None:
        return warm(args.warm, args.json)
    from caster.cli.installation import print_findings, report

    return print_findings(report(), args.json)


def warm(paths: Sequence[str], as_json: bool) -> int:
    """Compile kernels that are not cached yet, and print how many."""
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

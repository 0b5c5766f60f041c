"""`caster doctor`: what this machine has for the ray caster."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

from caster.exits import OK

if TYPE_CHECKING:
    from caster.doctor import Finding
    from caster.scene import Scene
    from caster.warming import Warmed

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
    from caster import doctor

    return show(doctor.report(), args)


def show(findings: Sequence[Finding], args: argparse.Namespace) -> int:
    """Print findings as asked; the exit code they make."""
    from caster import doctor

    print(doctor.format_json(findings) if args.json else doctor.format(findings))
    return doctor.exit_code(findings)


def warm(paths: Sequence[str], as_json: bool) -> int:
    """Compile what is not in the cache yet, and say how much that was."""
    from caster import warming
    from caster.kernels.compiling.kernel_cache import COMPILED
    from caster.kernels.jit import WORK
    from caster.progress import Progress, say_if_not_kept

    if not COMPILED:
        print("kernels: none, as Numba is switched off or not installed")
        return OK
    say_if_not_kept()
    progress = Progress()
    WORK.compiling = progress.compiling
    done = warming.warm(_named(paths) if paths else warming.every_scene(), progress.begin)
    progress.end()
    print(json.dumps(done._asdict()) if as_json else _in_words(done))
    return OK


def _named(paths: Sequence[str]) -> list[tuple[str, Scene]]:
    from caster.scene_files import load_scene

    return [(path, load_scene(path)) for path in paths]


def _in_words(done: Warmed) -> str:
    if not done.compiled:
        return f"kernels: 0 compiled, all {done.loaded} were in the cache"
    return f"kernels: {done.compiled} compiled, {done.loaded} loaded from the cache"

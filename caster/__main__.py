"""The command `caster`: what it can do is in caster/commands."""

import argparse
import sys
from collections.abc import Sequence

from caster import __version__, exits
from caster.commands import COMMANDS


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; its exit code."""
    return exits.run(lambda: _run(argv))


def _run(argv: Sequence[str] | None) -> int:
    args = parser().parse_args(argv)
    return int(args.run(args))


def parser() -> argparse.ArgumentParser:
    """What may be typed."""
    codes = exits.explained(exits.OK, exits.USAGE, exits.FILE, exits.INTERNAL, exits.INTERRUPTED)
    top = argparse.ArgumentParser(
        "caster", description="A ray caster in float64.", epilog=codes, allow_abbrev=False
    )
    top.add_argument("--version", action="version", version=f"caster {__version__}")
    commands = top.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for command in COMMANDS:
        name = command.__name__.rpartition(".")[2]
        sub = commands.add_parser(
            name, help=command.HELP, description=command.HELP, epilog=codes, allow_abbrev=False
        )
        command.add_arguments(sub)
        sub.set_defaults(run=command.run)
    return top


if __name__ == "__main__":
    sys.exit(main())

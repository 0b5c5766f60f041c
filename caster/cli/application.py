"""Commands under one name: `caster` and `mitsuba-ref` are made of it."""

import argparse
from collections.abc import Sequence
from types import ModuleType

from caster import __version__
from caster.cli import exit_codes

__all__ = ["main"]


def main(
    name: str, about: str, commands: Sequence[ModuleType], codes: Sequence[int], argv: Sequence[str] | None
) -> int:
    """Run one of the commands; its exit code. codes: those that --help explains."""

    def run() -> int:
        args = build_parser(name, about, commands, codes).parse_args(argv)
        return int(args.run(args))

    return exit_codes.run_command(run)


def build_parser(
    name: str, about: str, commands: Sequence[ModuleType], codes: Sequence[int]
) -> argparse.ArgumentParser:
    """What may be typed."""
    epilog = exit_codes.exit_codes_help(*codes)
    top = argparse.ArgumentParser(name, description=about, epilog=epilog, allow_abbrev=False)
    top.add_argument("--version", action="version", version=f"{name} {__version__}")
    group = top.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for command in commands:
        sub = group.add_parser(
            command_name(command),
            help=command.HELP,
            description=command.HELP,
            epilog=epilog,
            allow_abbrev=False,
        )
        command.add_arguments(sub)
        sub.set_defaults(run=command.run)
    return top


def command_name(command: ModuleType) -> str:
    """What is typed for it: its NAME, or that of its module."""
    return str(getattr(command, "NAME", command.__name__.rpartition(".")[2]))

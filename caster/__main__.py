"""The command `caster`; its commands are in caster/cli/commands."""

import sys
from collections.abc import Sequence

from caster.cli import application, exit_codes
from caster.cli.commands import COMMANDS

ABOUT = "A ray caster in float64."
CODES = (
    exit_codes.OK,
    exit_codes.USAGE,
    exit_codes.FILE,
    exit_codes.NOTHING_SELECTED,
    exit_codes.INTERNAL,
    exit_codes.INTERRUPTED,
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; its exit code."""
    return application.main("caster", ABOUT, COMMANDS, CODES, argv)


if __name__ == "__main__":
    sys.exit(main())

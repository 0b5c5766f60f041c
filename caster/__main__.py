"""The command `caster`: what it can do is in caster/commands."""

import sys
from collections.abc import Sequence

from caster import command_line, exits
from caster.commands import COMMANDS

ABOUT = "A ray caster in float64."
CODES = (exits.OK, exits.USAGE, exits.FILE, exits.NOTHING_SELECTED, exits.INTERNAL, exits.INTERRUPTED)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; its exit code."""
    return command_line.main("caster", ABOUT, COMMANDS, CODES, argv)


if __name__ == "__main__":
    sys.exit(main())

"""The command `caster`; its commands are in caster/cli."""

import sys
from collections.abc import Sequence

from caster.cli import COMMANDS, application
from caster.system import process

ABOUT = "A ray caster in float64."
CODES = (
    process.OK,
    process.USAGE,
    process.FILE,
    process.NOTHING_SELECTED,
    process.INTERNAL,
    process.INTERRUPTED,
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; its exit code."""
    return application.main("caster", ABOUT, COMMANDS, CODES, argv)


if __name__ == "__main__":
    sys.exit(main())

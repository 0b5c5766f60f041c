"""The command `mitsuba-ref`: what it can do is in mitsuba_ref/commands."""

import sys
from collections.abc import Sequence

from caster import command_line, exits
from mitsuba_ref.candidate import supervising
from mitsuba_ref.commands import COMMANDS

ABOUT = "A judge of ray casters: compares them with Mitsuba 3, ray by ray, within derived bounds."
CODES = tuple(code for code in exits.MEANINGS if code != exits.PIPE_CLOSED)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; its exit code. argv: its words; without them, those of this process, which may need a guard."""
    if argv is None and supervising.wanted(sys.argv[1:]):
        return supervising.run(sys.argv[1:])
    return command_line.main("mitsuba-ref", ABOUT, COMMANDS, CODES, argv)


if __name__ == "__main__":
    sys.exit(main())

"""The command `mitsuba-ref`; its commands are listed in mitsuba_ref/cli."""

import sys
from collections.abc import Sequence

from caster.cli import application
from caster.system import process
from mitsuba_ref.cli import COMMANDS
from mitsuba_ref.runner import supervisor

ABOUT = "A judge of ray casters: compares them with Mitsuba 3, ray by ray, within derived bounds."
CODES = tuple(code for code in process.MEANINGS if code != process.PIPE_CLOSED)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; its exit code. argv: default those of this process, which may need a supervisor."""
    if argv is None and supervisor.needs_supervision(sys.argv[1:]):
        return supervisor.run_supervised(sys.argv[1:])
    return application.main("mitsuba-ref", ABOUT, COMMANDS, CODES, argv)


if __name__ == "__main__":
    sys.exit(main())

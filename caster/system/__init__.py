"""Files, terminal, signals and platform, for the commands of both packages."""

import sys

__all__ = ["NOT_HERE", "runs_here"]

NOT_HERE = (
    "caster and mitsuba-ref run on Linux and other POSIX systems, not on Windows itself: install and run them in the "
    "Windows Subsystem for Linux (wsl --install)"
)


def runs_here() -> bool:
    return sys.platform != "win32"

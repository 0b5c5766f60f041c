"""Files, terminal, signals and platform, for the commands of both packages."""

import sys

__all__ = ["NOT_HERE"]

# Why the programs do not run on this system.
NOT_HERE = (
    "caster and mitsuba-ref run on Linux and other POSIX systems, not on Windows itself: install and run them in the "
    "Windows Subsystem for Linux (wsl --install)"
    if sys.platform == "win32"
    else ""
)

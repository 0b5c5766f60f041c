"""`caster doctor`: what this machine has for the ray caster."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from caster.doctor import Finding

HELP = "say what was found on this machine, and what each missing thing would add"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="as JSON")


def run(args: argparse.Namespace) -> int:
    """Print the findings; 4 when something needed is missing."""
    from caster import doctor

    return show(doctor.report(), args)


def show(findings: Sequence[Finding], args: argparse.Namespace) -> int:
    """Print findings as asked; the exit code they make."""
    from caster import doctor

    print(doctor.format_json(findings) if args.json else doctor.format(findings))
    return doctor.exit_code(findings)

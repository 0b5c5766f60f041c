"""`mitsuba-ref doctor`: what this machine has for the judge."""

import argparse

from caster.cli.commands import doctor as of_caster

HELP = of_caster.HELP
add_arguments = of_caster.add_json


def run(args: argparse.Namespace) -> int:
    """Print the findings; 4 when something needed is missing."""
    from mitsuba_ref.reference import installation

    return of_caster.print_findings(installation.report(), args)

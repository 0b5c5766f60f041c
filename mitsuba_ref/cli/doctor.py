"""`mitsuba-ref doctor`: what this machine has for the judge."""

import argparse

from caster.cli.installation import print_findings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="as JSON")


def run(args: argparse.Namespace) -> int:
    """Print the findings; 4 when something needed is missing."""
    from mitsuba_ref.reference import installation

    return print_findings(installation.report(), args.json)

"""`mitsuba-ref doctor`: what this machine has for the judge."""

import argparse

HELP = "say what was found on this machine, and what each missing thing would add"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="as JSON")


def run(args: argparse.Namespace) -> int:
    """Print the findings; 4 when something needed is missing."""
    from mitsuba_ref import doctor

    findings = doctor.report()
    print(doctor.format_json(findings) if args.json else doctor.format(findings))
    return doctor.exit_code(findings)

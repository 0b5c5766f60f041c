"""`caster info`: what is in an EXR file."""

import argparse
import json
import sys

HELP = "describe an EXR file: channels, ranges, NaN, inf and hit counts, histograms, provenance"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE.exr", help="an EXR file; of a multi-part one, all parts")
    parser.add_argument("--json", action="store_true", help="as JSON, with all of the provenance")


def run(args: argparse.Namespace) -> int:
    """Print the description. Raises FileMissing, UnreadableExr."""
    from caster.image.exr_info import describe_exr, format_info

    info = describe_exr(args.file)
    print(
        json.dumps(info, indent=2, allow_nan=False) if args.json else format_info(info, sys.stdout.encoding)
    )
    return 0

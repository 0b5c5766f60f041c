"""The options of `mitsuba-ref validate` that continuous integration uses."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mitsuba_ref.verdict import Verdict


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add(
        "--summary-md",
        metavar="FILE",
        help="add a summary in Markdown to the end of this file, such as $GITHUB_STEP_SUMMARY",
    )


def check_outputs(args: argparse.Namespace) -> None:
    """Raise OutputError now, and not after all the work."""
    from caster.whole_files import check_writable

    if args.summary_md:
        check_writable(args.summary_md)


def report(verdict: Verdict, args: argparse.Namespace, seconds: float) -> None:
    """The files that were asked for."""
    if args.summary_md:
        from mitsuba_ref.ci.summary import append

        append(args.summary_md, verdict, seconds)

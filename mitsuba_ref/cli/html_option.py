"""The option --html of `mitsuba-ref validate`: the verdict as a page."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mitsuba_ref.report.html.html_report import HtmlReport

SUFFIX = ".html"


def add(parser: argparse.ArgumentParser) -> None:
    words = f"write a report for the browser: a folder, or one file if PATH ends in {SUFFIX}"
    parser.add_argument("--html", metavar="PATH", help=words)


def page_of(args: argparse.Namespace) -> str:
    """The file to open, "" if no report was asked for."""
    if not args.html:
        return ""
    return args.html if args.html.lower().endswith(SUFFIX) else str(Path(args.html) / "index.html")


def begun(args: argparse.Namespace, asked: int, candidate: str = "") -> HtmlReport | None:
    """The report that was asked for, empty; candidate: as in Report. Raises OutputError now, not after the work."""
    if not args.html:
        return None
    from mitsuba_ref.report.html.html_report import HtmlReport

    return HtmlReport(args.html, asked, candidate)


def finish(report: HtmlReport | None, not_judged: Collection[str]) -> None:
    """Write what there is of it, and say what went of earlier ones; not of scenes that this run did not come to.

    Raises OutputError.
    """
    if report:
        try:
            report.write()
            if words := report.sweep(not_judged).words(report.data):
                print(words, file=sys.stderr)
        finally:
            report.close()

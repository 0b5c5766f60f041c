"""`mitsuba-ref stress`: one thing made harder and harder, until somebody breaks down."""

from __future__ import annotations

import argparse
import json
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from caster.cli.exit_codes import DIFFERENCES, NOTHING_SELECTED, OK
from caster.cli.progress import StatusLine
from mitsuba_ref.cli.options import check_report, positive_int

if TYPE_CHECKING:
    from mitsuba_ref.stress.family import Family
    from mitsuba_ref.stress.sweeps import Sweep


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add(
        "families",
        metavar="FAMILY",
        nargs="*",
        help="such as tangency, or watertight for both that begin so; default: all",
    )
    add(
        "-k", metavar="EXPR", dest="expression", help="families whose name fits, such as 'scale and not mesh'"
    )
    add("--list", action="store_true", help="say which families there are, and stop")
    add("--rays", metavar="N", type=positive_int, help="rays of each setting; default: 400, watertight 10000")
    add("--seed", metavar="S", type=seed, default=0, help="of the rays; default: 0")
    add(
        "--json",
        metavar="FILE",
        help="write the result as JSON; - is standard output, which then holds nothing else",
    )
    add("--report", metavar="DIR", help="write stress.md and its pictures into this folder")


def seed(text: str) -> int:
    """A whole number >= 0, or an error in argparse's way."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"expected a whole number >= 0, got '{text}'")
    return int(text)


def run(args: argparse.Namespace) -> int:
    """Sweep what was selected; 0 ours is right everywhere, 1 it is not, 5 nothing selected, 130 interrupted."""
    from mitsuba_ref.stress import FAMILIES
    from mitsuba_ref.stress.selection import select_families

    families = select_families(FAMILIES, args.families, args.expression)
    if not families:
        print(f"nothing selected: no family fits -k {args.expression!r}", file=sys.stderr)
        return NOTHING_SELECTED
    if args.list:
        print("\n".join(f"{family.name:22}{family.title}" for family in families))
        return OK
    check_report(args.json, args.report)
    done: list[Sweep] = []
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # a cancelled job tidies up as after Ctrl-C
    try:
        work_through(families, args, done)
    finally:  # what is done is kept, whatever ends the work
        report(done, families, args)
    return OK if all(sweep.ok for sweep in done) else DIFFERENCES


def work_through(families: list[Family], args: argparse.Namespace, done: list[Sweep]) -> None:
    """Print each family's table as soon as it is done."""
    from mitsuba_ref.stress import table
    from mitsuba_ref.stress.sweeps import sweep

    for i, family in enumerate(families):
        say = Progress(f"{i + 1}/{len(families)} {family.name}")
        done.append(sweep(family, args.seed, args.rays, say))
        say.clear()
        print(f"{table.as_text(done[-1])}\n", file=spoken(args), flush=True)


class Progress:
    """One line on a terminal's stderr, written over again and again; nothing elsewhere."""

    def __init__(self, what: str) -> None:
        self.what, self.line = what, StatusLine()

    def __call__(self, words: str) -> None:
        self.line.show(f"{self.what}: {words}")

    def clear(self) -> None:
        self.line.erase()


def report(done: list[Sweep], families: list[Family], args: argparse.Namespace) -> None:
    """The files that were asked for, and a last line."""
    from caster.image.atomic_files import write_text
    from mitsuba_ref.stress.page import write_report
    from mitsuba_ref.stress.sweeps import as_json, versions

    asked = [family.name for family in families]
    if args.json:
        text = json.dumps(as_json(done, asked, args.seed, versions()), indent=1, allow_nan=False) + "\n"
        if args.json == "-":
            sys.stdout.write(text)
        else:
            write_text(args.json, text)
    if args.report:
        write_report(done, args.seed, versions(), Path(args.report))
    failing = [sweep.family.name for sweep in done if not sweep.ok]
    names = f": {', '.join(failing)}" if failing else ""
    print(f"{len(done)} of {len(asked)} families, {len(failing)} fail{names}", file=spoken(args))


def spoken(args: argparse.Namespace) -> TextIO:
    """Where tables go: a program that reads JSON from standard output is to find nothing else there."""
    return sys.stderr if args.json == "-" else sys.stdout

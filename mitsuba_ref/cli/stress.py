"""`mitsuba-ref stress`: numerical stability in sweeps that get harder and harder."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from caster.cli.exit_codes import DIFFERENCES, NOTHING_SELECTED, OK
from mitsuba_ref.cli import experiment_options as options
from mitsuba_ref.cli.options import positive_int

if TYPE_CHECKING:
    from mitsuba_ref.stress.family import Family
    from mitsuba_ref.stress.sweeps import SweepResult


def add_arguments(parser: argparse.ArgumentParser) -> None:
    options.add_selection(parser, "family", "such as tangency, or watertight for both; default: all")
    add = parser.add_argument
    add("--rays", metavar="N", type=positive_int, help="rays of each setting; default: 400, watertight 10000")
    add("--seed", metavar="S", type=options.whole, default=0, help="of the rays; default: 0")
    options.add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Sweep the selected families; 0 ours is right everywhere, 1 it is not, 5 nothing selected, 130 interrupted."""
    from mitsuba_ref import stress

    families = options.select(stress.FAMILIES, "family", args.families, args.expression)
    if not families:
        print(f"nothing selected: no family matches -k {args.expression!r}", file=sys.stderr)
        return NOTHING_SELECTED
    if args.list:
        print("\n".join(f"{family.name:22}{family.title}" for family in families))
        return OK
    options.check_json(args)
    done: list[SweepResult] = []
    try:
        sweep_all(families, args, done)
    finally:  # what is done is kept, whatever ends the work
        report(done, families, args)
    return OK if all(sweep.ok for sweep in done) else DIFFERENCES


def sweep_all(families: list[Family], args: argparse.Namespace, done: list[SweepResult]) -> None:
    """Print each family's table as soon as it is done."""
    from mitsuba_ref.stress import sweeps

    for i, family in enumerate(families):
        progress = options.Progress(f"{i + 1}/{len(families)} {family.name}")
        done.append(sweeps.sweep(family, args.seed, args.rays, progress))
        progress.clear()
        print(f"{sweeps.as_text(done[-1])}\n", file=options.table_stream(args), flush=True)


def report(done: list[SweepResult], families: list[Family], args: argparse.Namespace) -> None:
    """The JSON file, if any, and a last line."""
    if args.json:
        from mitsuba_ref.experiment.results import libllvm, versions, write_result
        from mitsuba_ref.stress.sweeps import StressRun

        installed = versions("mitsuba", "drjit", "numpy") | {"libllvm": libllvm()}
        requested = tuple(family.name for family in families)
        write_result(StressRun(args.seed, installed, requested, tuple(done)), args.json)
    failing = [sweep.name for sweep in done if not sweep.ok]
    names = f": {', '.join(failing)}" if failing else ""
    text = f"{len(done)} of {len(families)} families, {len(failing)} fail{names}"
    print(text, file=options.table_stream(args))

"""`mitsuba-ref merge`: the shards of a run put together into one verdict."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from caster.cli.exit_codes import DIFFERENCES, OK
from mitsuba_ref.cli import output_options as ci


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add(
        "verdicts",
        metavar="VERDICT.json|DIR",
        nargs="+",
        help="of each shard: --json's file, or --out's folder",
    )
    add(
        "--other-versions",
        action="store_true",
        help="take shards together that were judged with different versions of Mitsuba, libLLVM or libraries, too",
    )
    add("--json", metavar="FILE", help="write the whole verdict as JSON")
    add("--junit", metavar="FILE", help="write it as JUnit XML")
    ci.add_summary(parser)


def run(args: argparse.Namespace) -> int:
    """Print what fails and the summary; 0 all pass, 1 some do not or are missing, 3 not parts of one run."""
    from caster.image.atomic_files import check_writable, write_text
    from mitsuba_ref.report import terminal
    from mitsuba_ref.report.junit import junit
    from mitsuba_ref.report.markdown import append
    from mitsuba_ref.runner.shards import merge_verdicts, other_versions
    from mitsuba_ref.runner.verdict_file import read_verdict

    for path in filter(None, (args.json, args.junit, args.summary_md)):
        check_writable(path)
    places = [str(Path(place) / "verdict.json") if Path(place).is_dir() else place for place in args.verdicts]
    parts = [(place, read_verdict(place)) for place in places]
    verdict, missing = merge_verdicts(parts, any_versions=args.other_versions)
    for words in other_versions(parts):
        print(f"{words}: taken together, as asked", file=sys.stderr)
    seconds = sum(scene.seconds for scene in verdict.scenes if not scene.kept)
    if args.json:
        write_text(args.json, json.dumps(verdict.to_dict(), indent=1, allow_nan=False) + "\n")
    if args.junit:
        write_text(args.junit, junit(verdict))
    if args.summary_md:
        append(args.summary_md, verdict, seconds)
    for scene in verdict.scenes:
        if not scene.ok:
            print(f"{terminal.failure_text(scene)}\n")
    for name in verdict.not_judged:
        print(f"FAIL  {name}  not judged")
    print(terminal.summary_text(verdict, seconds))
    for words in missing:
        print(f"{words}: expected the verdict of every shard", file=sys.stderr)
    return OK if verdict.ok and not missing else DIFFERENCES

"""`mitsuba-ref merge`: the verdicts of all shards of a run as one verdict."""

import argparse
import sys
from pathlib import Path

from caster.cli.exit_codes import DIFFERENCES, OK
from mitsuba_ref.cli.options import add_verdict_files, check_verdict_files, write_verdict_files


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "verdicts",
        metavar="VERDICT.json|DIR",
        nargs="+",
        help="of each shard: --json's file, or --out's folder",
    )
    parser.add_argument(
        "--other-versions",
        action="store_true",
        help="merge also shards that were judged with different versions of Mitsuba, libLLVM or libraries",
    )
    add_verdict_files(parser)


def run(args: argparse.Namespace) -> int:
    """Print failures and the summary; 0 all pass, 1 some do not or are missing, 3 not parts of one run."""
    from mitsuba_ref.report.terminal import failure_text, summary_text
    from mitsuba_ref.report.text_table import print_lines
    from mitsuba_ref.runner.resume import read_verdict
    from mitsuba_ref.runner.shards import merge_verdicts, other_versions

    check_verdict_files(args)
    places = [str(Path(place) / "verdict.json") if Path(place).is_dir() else place for place in args.verdicts]
    parts = [(place, read_verdict(place)) for place in places]
    verdict, missing = merge_verdicts(parts, any_versions=args.other_versions)
    for difference in other_versions(parts):
        print(f"{difference}: merged all the same, by --other-versions", file=sys.stderr)
    seconds = sum(scene.seconds for scene in verdict.scenes if not scene.kept)
    write_verdict_files(verdict, args, seconds)
    for scene in verdict.scenes:
        if not scene.ok:
            print_lines(f"{failure_text(scene)}\n")
    for name in verdict.not_judged:
        print_lines(f"FAIL  {name}  not judged")
    print(summary_text(verdict, seconds))
    for part in missing:
        print(f"{part}: expected the verdict of every shard", file=sys.stderr)
    return OK if verdict.ok and not missing else DIFFERENCES

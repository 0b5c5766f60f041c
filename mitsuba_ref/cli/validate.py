"""`mitsuba-ref validate`: judge scenes against Mitsuba, one row each; `merge`: the verdicts of all shards as one."""

from __future__ import annotations

import argparse
import sys
import time
import traceback
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from caster.cli.shared_arguments import InputPath, OutputFile, OutputFolder, positive_int
from caster.description.errors import SceneError
from caster.system.process import DIFFERENCES, FILE, INTERNAL, NOTHING_SELECTED, OK, USAGE
from mitsuba_ref.cli.options import (
    add_candidate,
    add_reading,
    add_selection,
    add_skip_unsupported,
    add_store,
    add_timeout,
    add_verdict_files,
    check_verdict_files,
    requested_candidate,
    selected_entries,
    write_verdict_files,
)

UNSUPPORTED_SCENE = "unsupported"  # of the judge, which takes long to load (tests/unit/test_cli_help.py compares)

if TYPE_CHECKING:
    from mitsuba_ref.judge.verdict import Verdict
    from mitsuba_ref.runner.many_scenes import SceneSource
    from mitsuba_ref.runner.shards import Shard
    from mitsuba_ref.runner.validation_run import RunOptions, ValidationRun
    from mitsuba_ref.subjects.subject import Subject


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_selection(parser)
    add = parser.add_argument
    add(
        "--out", metavar="DIR", type=OutputFolder, help="write verdict.json, EXR files and reproducers into this folder"
    )
    add_verdict_files(parser)
    add("--html", metavar="DIR", type=OutputFolder, help="write a report for the browser into this folder: index.html")
    add(
        "--expected",
        metavar="FILE",
        type=InputPath,
        help="known failures, as --write-expected writes them: the run fails only by others, and names fixed ones",
    )
    help_ = "write the failures of this run as a file for --expected"
    add("--write-expected", metavar="FILE", type=OutputFile, help=help_)
    add_skip_unsupported(parser, "scenes")
    help_ = "fail where fewer scenes are judged and not declined; default 1 with --skip-unsupported"
    add("--min-scenes", metavar="N", type=positive_int, default=0, help=help_)
    add("--maxfail", metavar="N", type=positive_int, help="stop after so many scenes that fail")
    add("--shard", metavar="I/N", type=shard, help="judge part I of N of the scenes, balanced by pixels")
    add_timeout(parser)
    add_store(parser)
    add_candidate(parser)
    add_reading(parser, "; with --candidate")


def shard(text: str) -> Shard:
    """The type of --shard; its module is loaded only where the option is given."""
    from mitsuba_ref.runner.shards import parse_shard

    return parse_shard(text)


def run(args: argparse.Namespace) -> int:
    """Validate the selected scenes; 0 all pass, 1 some do not, 5 nothing was selected, 130 interrupted."""
    entries = selected_entries(args)
    if not entries:
        return NOTHING_SELECTED
    check_outputs(args)
    candidate = requested_candidate(args)  # its errors come before any work, as do those of the variant
    from mitsuba_ref.reference import variants
    from mitsuba_ref.runner.validation_run import ValidationRun

    variants.require_variants()
    start = time.perf_counter()
    running = ValidationRun(entries, run_options(args), candidate)
    try:
        if candidate is not None and candidate.takes_rays:
            print_conventions(candidate, entries[0])
        print_rows(running)
    finally:  # whatever ends the work, the results so far are written
        write_results(running, args, time.perf_counter() - start)
    return exit_code(running.verdict(), running.errors)


def print_conventions(candidate: Subject, entry: SceneSource) -> None:
    """What a few rays of the first scene show of a candidate's conventions, before all scenes are judged."""
    from mitsuba_ref.judge.checks.ray_conventions import check_ray_conventions
    from mitsuba_ref.report.results import print_lines

    try:
        found = check_ray_conventions(candidate, entry.load().scene)
    except (SceneError, MemoryError):  # which the row of the scene names
        return
    if found is not None and not found.ok:
        print_lines(f"conventions: {found.what} ({entry.name})\n", sys.stdout)


def exit_code(verdict: Verdict, errors: Sequence[Exception]) -> int:
    """0 where all pass; 70 or 4 for an internal error or a file that cannot be written; 2 or 4 where nothing else
    fails than scenes that cannot be loaded; else 1."""
    from caster.system.atomic_files import OutputError

    if verdict.ok:
        return OK
    if verdict.scenes and all(scene.waived == UNSUPPORTED_SCENE for scene in verdict.scenes):
        return NOTHING_SELECTED
    for error in errors:
        if not isinstance(error, (SceneError, MemoryError, OSError)):
            traceback.print_exception(error)
            return INTERNAL
    if any(isinstance(error, OutputError) for error in errors):
        return FILE
    codes = [error.exit_code if isinstance(error, SceneError) else USAGE for error in errors]
    alone = sum(not (scene.ok or scene.waived) for scene in verdict.scenes) + len(verdict.not_judged) == len(codes)
    return min(codes) if codes and alone else DIFFERENCES


def check_outputs(args: argparse.Namespace) -> None:
    """Raise OutputError before any work where a file cannot be written."""
    from caster.system.atomic_files import check_folder, check_writable

    if args.out:
        check_folder(args.out)
    check_verdict_files(args)
    if getattr(args, "write_expected", None):
        check_writable(args.write_expected)


def run_options(args: argparse.Namespace) -> RunOptions:
    from mitsuba_ref.runner.validation_run import RunOptions, read_expected

    chosen = args.expression or args.builtin
    whole_folders = not chosen and all(Path(place).is_dir() for place in args.scenes)
    out = Path(args.out) if args.out else None
    return RunOptions(
        args.workers,
        args.maxfail,
        out,
        args.html,
        args.shard,
        args.timeout,
        args.store,
        read_expected(args.expected) if args.expected else None,
        args.skip_unsupported,
        args.min_scenes,
        whole_folders,
    )


def print_rows(running: ValidationRun) -> None:
    """A row for each scene as soon as it and those before it are done."""
    from mitsuba_ref.report.results import print_lines
    from mitsuba_ref.report.verdict_text import table_head, table_row

    width = max((len(entry.name) for entry in running.entries), default=0)
    # The stream itself: readers of EXR files in other threads replace sys.stdout while they read.
    out = sys.stdout
    print_lines(table_head(width), out)
    with closing(running.verdicts()) as verdicts:
        for verdict in verdicts:
            print_lines(table_row(verdict, width), out)


def write_results(running: ValidationRun, args: argparse.Namespace, seconds: float) -> None:
    """Write the report files, then print failures and the summary."""
    from mitsuba_ref.report.results import print_lines
    from mitsuba_ref.report.verdict_text import failures_text, summary_text

    verdict = running.verdict()
    try:
        write_verdict_files(verdict, args, seconds)
        write_expected(verdict, args)
        if failures := failures_text(verdict, report_page(args)):
            print_lines(f"\n{failures}")
        print_lines(f"\n{summary_text(verdict, seconds)}")
    finally:
        for removed in filter(None, running.finish()):
            print(removed, file=sys.stderr)


def write_expected(verdict: Verdict, args: argparse.Namespace) -> None:
    """Write --write-expected, unless scenes are left that were not judged. Raises OutputError."""
    from caster.system.atomic_files import write_text
    from mitsuba_ref.runner.validation_run import expected_toml

    path = getattr(args, "write_expected", None)
    if path and verdict.not_judged:
        print(f"{path}: not written: {len(verdict.not_judged)} scenes were not judged", file=sys.stderr)
    elif path:
        write_text(path, expected_toml(verdict.scenes))


def report_page(args: argparse.Namespace) -> str:
    """The HTML file to open, "" without --html."""
    return str(Path(args.html) / "index.html") if args.html else ""


# ---- mitsuba-ref merge ----


def add_merge_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "verdicts",
        metavar="VERDICT.json|DIR",
        type=InputPath,
        nargs="+",
        help="of each shard: --json's file, or --out's folder",
    )
    add_verdict_files(parser)


def run_merge(args: argparse.Namespace) -> int:
    """Print failures and the summary; 0 all pass, 1 some do not or are missing, 3 not parts of one run."""
    from mitsuba_ref.report.results import print_lines
    from mitsuba_ref.report.verdict_text import failures_text, summary_text
    from mitsuba_ref.runner.shards import merge_verdicts
    from mitsuba_ref.runner.verdict_files import read_verdict

    check_verdict_files(args)
    places = [str(Path(place) / "verdict.json") if Path(place).is_dir() else place for place in args.verdicts]
    verdict, missing = merge_verdicts([(place, read_verdict(place)) for place in places])
    seconds = sum(scene.seconds for scene in verdict.scenes if not scene.kept)
    write_verdict_files(verdict, args, seconds)
    if failures := failures_text(verdict):
        print_lines(f"{failures}\n")
    for name in verdict.not_judged:
        print_lines(f"FAIL  {name}  not judged")
    print(summary_text(verdict, seconds))
    for part in missing:
        print(f"{part}: expected the verdict of every shard", file=sys.stderr)
    return OK if verdict.ok and not missing else DIFFERENCES

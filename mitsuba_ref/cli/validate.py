"""`mitsuba-ref validate`: judge scenes against Mitsuba, one row each; `merge`: the verdicts of all shards as one."""

import os
import sys
import time
import traceback
from argparse import Namespace
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, TextIO

from caster.cli.shared_arguments import check_film_size, display_names, scene_files
from caster.description.errors import FileMissing, SceneError
from caster.system.atomic_files import OutputError, check_folder, write_text
from caster.system.process import DIFFERENCES, FILE, INTERNAL, NOTHING_SELECTED, OK, USAGE
from mitsuba_ref.cli.arguments import DEFAULT_SCENES, REFERENCE_OPTIONS
from mitsuba_ref.cli.options import (
    OPENING_OPTIONS,
    NothingSelected,
    candidate_words,
    given_words,
    opening_of,
    report_address,
    requested_candidate,
    table_stream,
)
from mitsuba_ref.judge.verdict import UNSUPPORTED, Verdict
from mitsuba_ref.reference import variants
from mitsuba_ref.report import builtin_scenes
from mitsuba_ref.report.ci_summaries import append, junit
from mitsuba_ref.report.output import STANDARD_OUTPUT, print_lines, write_result
from mitsuba_ref.report.verdict_text import failures_text, summary_text, table_head, table_row
from mitsuba_ref.runner.many_scenes import JudgeOptions, SceneEntry, matching
from mitsuba_ref.runner.shards import merge_verdicts
from mitsuba_ref.runner.validation_run import VERDICT, ValidationRun, expected_toml, read_expected
from mitsuba_ref.runner.verdict_files import read_verdict


def run_validate(args: Namespace) -> int:
    """Validate the selected scenes; 0 all pass, 1 some do not, 5 nothing was selected, 130 interrupted."""
    entries = selected_entries(args)
    out = without_earlier_results(args)
    candidate = requested_candidate(args)
    if args.thorough and candidate is not None:
        raise SceneError("--thorough: not with a candidate: it tests our own caster")
    if args.bounces and candidate is not None and not candidate.takes_rays:
        raise SceneError(f"--bounces: expected a candidate that takes rays; {candidate.name} renders images")
    return judge_entries(
        args,
        entries,
        JudgeOptions(timeout=args.timeout, store=args.store, subject=candidate, thorough=args.thorough),
        out,
        expected=read_expected(args.expected) if args.expected else None,
        **{name: getattr(args, name) for name in RUN_OPTIONS},
    )


RUN_OPTIONS = ("workers", "engine", "maxfail", "shard", "skip_unsupported", "min_scenes")  # of ValidationRun
BUILTIN_HINT = "--builtin triangles takes scenes that are installed with the program"


def selected_entries(args: Namespace) -> list[SceneEntry]:
    """The selected scenes, not loaded yet. Raises SceneError, NothingSelected."""
    fits = matching(args.expression)
    again = (*given_words(args, "mesh_dir", *OPENING_OPTIONS, *REFERENCE_OPTIONS), *candidate_words(args))
    opening = opening_of(args)
    named = [] if args.builtin and args.scenes is DEFAULT_SCENES else args.scenes
    places = [*builtin_scenes.folders_of(args.builtin), *named]
    try:
        files = [file for file in scene_files(places) if fits(Path(file).stem)]
    except FileMissing:
        if args.scenes is not DEFAULT_SCENES:
            raise
        where = f"expected a scene, a mesh file or a folder: none is named, and there is no folder '{places[-1]}' here"
        raise FileMissing(f"{where}; {BUILTIN_HINT}") from None
    if args.size:
        check_film_size("--size", *args.size)
    size, names = tuple(args.size) if args.size else None, display_names(files)
    sized = ("--size", *map(str, args.size)) if args.size else ()
    entries = [
        SceneEntry(
            f"{name}.bounce-{number}" if number else name,
            file,
            size,
            tuple(args.mesh_dir),
            (*again, *sized, "--bounces", str(number)) if number else again,  # a bounce has a film of its own
            opening=opening,
            bounce=number,
        )
        for name, file in zip(names, files, strict=True)
        for number in range(getattr(args, "bounces", 0) + 1)
    ]
    if not entries:
        fitting = f" that fits -k {args.expression!r}" if args.expression else ""
        hint = "" if args.expression else f"; {BUILTIN_HINT}"
        raise NothingSelected(f"nothing selected: no scene file{fitting} in {', '.join(places)}{hint}")
    return entries


def without_earlier_results(args: Namespace) -> Path | None:
    """Remove verdicts of an earlier run, which would be taken for this one's if it ended without any; the --out folder.

    Before a candidate is loaded, which may end the process.
    """
    for path in {args.json, args.junit} - {None, STANDARD_OUTPUT}:
        if os.path.isfile(path) and not os.path.islink(path):  # /dev/stdout is a link
            os.unlink(path)
    if not args.out:
        return None
    folder = check_folder(Path(args.out))
    (folder / VERDICT).unlink(missing_ok=True)
    return folder


def judge_entries(
    args: Namespace, entries: Sequence[SceneEntry], judge: JudgeOptions, out: Path | None, **more: Any
) -> int:
    """Print a row for each scene, and write the files that the options name; the exit code. more: of ValidationRun."""
    variants.require_variants()  # its errors come before any work
    start, stream = time.perf_counter(), table_stream(args)
    running = ValidationRun(entries, judge, out, args.html, **more)
    try:
        width = max((len(entry.name) for entry in running.entries), default=0)
        print_lines(table_head(width), stream)
        with closing(running.verdicts()) as verdicts:
            for scene in verdicts:  # as soon as it and all scenes before it are done
                print_lines(table_row(scene, width), stream)
    finally:  # whatever ends the work, the results so far are written
        verdict = running.verdict()
        write_results(running, verdict, args, time.perf_counter() - start, stream)
    return exit_code(verdict, running.errors)


def exit_code(verdict: Verdict, errors: Sequence[Exception]) -> int:
    """0 if all pass; 70 or 4 for an internal error or a file that cannot be written; 2 or 4 if only scenes that cannot
    be loaded fail; else 1."""
    if verdict.ok:
        return OK
    if verdict.scenes and all(scene.waived == UNSUPPORTED for scene in verdict.scenes):
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


def write_results(running: ValidationRun, verdict: Verdict, args: Namespace, seconds: float, stream: TextIO) -> None:
    """Write the report files, then print failures and the summary."""
    expected = getattr(args, "write_expected", None)
    try:
        write_verdict_files(verdict, args, seconds)
        if expected and verdict.not_judged:
            print(f"{expected}: not written: {len(verdict.not_judged)} scenes were not judged", file=sys.stderr)
        elif expected:
            write_text(expected, expected_toml(verdict.scenes))
        report = str(Path(args.html) / "index.html") if args.html else ""
        if failures := failures_text(verdict, report):
            print_lines(f"\n{failures}", stream)
        print_lines(f"\n{summary_text(verdict, seconds)}", stream)
        if args.html:
            print_lines(report_address(args.html), stream)
    finally:
        running.finish(verdict)


def write_verdict_files(verdict: Verdict, args: Namespace, seconds: float) -> None:
    """Write --json, --junit and --summary-md. Raises OutputError."""
    write_result(verdict, args.json)
    if args.junit:
        write_text(args.junit, junit(verdict))
    if args.summary_md:
        append(args.summary_md, verdict, seconds)


# ---- mitsuba-ref merge ----


def run_merge(args: Namespace) -> int:
    """Print failures and the summary; 0 all pass, 1 some fail or are missing, 3 the files are not of one run."""
    places = [str(Path(place) / VERDICT) if Path(place).is_dir() else place for place in args.verdicts]
    verdict, missing = merge_verdicts([(place, read_verdict(place)) for place in places])
    stream = table_stream(args)
    seconds = sum(scene.seconds for scene in verdict.scenes if not scene.kept)
    write_verdict_files(verdict, args, seconds)
    if failures := failures_text(verdict):
        print_lines(f"{failures}\n", stream)
    for name in verdict.not_judged:
        print_lines(f"FAIL  {name}  not judged", stream)
    print_lines(summary_text(verdict, seconds), stream)
    if missing:
        print(f"{missing}; expected the verdict of every shard", file=sys.stderr)
    return OK if verdict.ok and not missing else DIFFERENCES

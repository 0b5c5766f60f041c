"""`mitsuba-ref fuzz`: random scenes against exact arithmetic and Mitsuba."""

import argparse
import itertools
from pathlib import Path

from caster.cli.shared_arguments import scene_files
from caster.system.process import DIFFERENCES, OK
from caster.system.terminal import StatusLine
from mitsuba_ref.cli import options
from mitsuba_ref.fuzz import findings
from mitsuba_ref.fuzz.cases import read_kept
from mitsuba_ref.fuzz.checks import find
from mitsuba_ref.fuzz.findings import replay_text
from mitsuba_ref.fuzz.fuzz_run import Drawing, FuzzRun
from mitsuba_ref.hard import FAMILIES
from mitsuba_ref.reference import variants
from mitsuba_ref.report.results import print_lines, write_result
from mitsuba_ref.subjects.subject import OURS

DEFAULT_SECONDS = 60.0


def run(args: argparse.Namespace) -> int:
    """Fuzz; 0 nothing found, 1 something found, 5 nothing selected, 130 interrupted."""
    if args.replay is not None:
        return replay(args)
    families = options.select(FAMILIES, "family", args.family)
    limit = args.time if args.time is not None or args.examples is not None else DEFAULT_SECONDS
    examples = itertools.count() if args.examples is None else args.examples
    names, candidate = tuple(family.name for family in families), options.requested_candidate(args)
    drawing = Drawing(args.seed, names, args.judge_every, args.rays, candidate)
    about = Path(args.out), args.keep, options.candidate_words(args), args.engine, args.workers
    running = FuzzRun(drawing, examples, limit, *about)
    if args.examples is not None and not args.examples:
        raise options.NothingSelected("nothing selected: --examples 0 selects no example")
    if args.judge_every or candidate:
        variants.require_variants()  # a wrong choice of variant fails before any work
    line = StatusLine()
    try:
        for done in running.run():
            total = done.total
            line.show(f"{total.examples} examples, {total.rays} rays, {total.findings} findings, {done.seconds:.0f} s")
    finally:  # what is found is kept, whatever ends the work
        line.erase()
        print_lines(findings.text(running.outcome), options.table_stream(args))
        write_result(running.outcome, args.json)
    return OK if running.outcome.ok else DIFFERENCES


def replay(args: argparse.Namespace) -> int:
    """Check kept scenes again: 0 all pass today, 1 some fail, 2 a file is damaged, 4 missing, 5 an empty folder."""
    files = [each for each in scene_files([args.replay]) if not each.endswith(".json")]  # such as that of --json
    if not files:
        raise options.NothingSelected(f"nothing selected: no scene file in {args.replay}")
    kept = [(file, read_kept(Path(file))) for file in files]
    subject = options.requested_candidate(args) or OURS
    replays = [(file, kind, find(case, kind, subject=subject)) for file, (kind, case) in kept]
    print(replay_text(replays))
    return DIFFERENCES if any(findings for *_, findings in replays) else OK

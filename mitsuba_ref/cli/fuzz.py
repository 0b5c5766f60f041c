"""`mitsuba-ref fuzz`: random scenes against exact arithmetic and Mitsuba."""

from __future__ import annotations

import argparse
import itertools
import json
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from caster.cli.shared_arguments import InputPath, OutputFile, OutputFolder, positive_int
from caster.system.process import DIFFERENCES, NOTHING_SELECTED, OK
from caster.system.terminal import StatusLine
from mitsuba_ref.cli import options

if TYPE_CHECKING:
    from mitsuba_ref.fuzz.campaign import Campaign

DEFAULT_SECONDS = 60.0
UNITS = {"": 1.0, "s": 1.0, "m": 60.0, "h": 3600.0}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--time", metavar="T", type=seconds, help="stop after this time, such as 60s, 5m, 1h; default: 60s")
    add("--examples", metavar="N|A..B", type=numbers, help="number of examples, or those from A to B")
    add("--seed", metavar="S", type=options.whole, default=0, help="example i of seed S is always the same; default: 0")
    help_ = "only this family of scenes; may be given several times"
    add("--family", type=str, metavar="NAME", action="append", default=[], help=help_)
    help_ = "where failing scenes are kept; default: fuzz-failures"
    add("--out", type=OutputFolder, metavar="DIR", default="fuzz-failures", help=help_)
    help_ = "findings of one kind in one family that are shrunk and kept; all are counted; default: 3"
    add("--keep", metavar="N", type=options.whole, default=3, help=help_)
    add("--json", metavar="FILE", type=OutputFile, help="write the result as JSON")
    help_ = "one scene in N, on average, gets --thorough checks and is compared with Mitsuba; 0: none; default: 16"
    add("--judge-every", metavar="N", type=options.whole, default=16, help=help_)
    add("--replay", metavar="FILE|DIR", type=InputPath, help="check kept scenes again, and nothing else")
    add("--rays", metavar="N", type=positive_int, default=40, help="rays aimed at each scene; default: 40")
    options.add_candidate(parser, "another ray caster, judged in place of ours in each scene (docs/candidates.md)")


def seconds(text: str) -> float:
    """Parse a time. Raises argparse.ArgumentTypeError."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([a-z]*)", text)
    if match is None or match[2] not in UNITS:
        raise argparse.ArgumentTypeError(f"expected a time such as 60s, 5m or 1h, got '{text}'")
    return float(match[1]) * UNITS[match[2]]


def numbers(text: str) -> range:
    """Parse numbers of examples: N for the first N, A..B for A to B. Raises argparse.ArgumentTypeError."""
    first, dots, last = text.partition("..")
    if not first.isdecimal() or (dots and not last.isdecimal()) or (dots and int(first) > int(last)):
        raise argparse.ArgumentTypeError(f"expected how many, such as 100, or from..to, such as 41..41, got '{text}'")
    return range(int(first), int(last) + 1) if dots else range(int(first))


def run(args: argparse.Namespace) -> int:
    """Run a campaign; 0 nothing found, 1 something found, 5 nothing selected, 130 interrupted."""
    if args.replay is not None:
        return replay(args)
    options.check_json(args)
    from caster.system.atomic_files import write_text
    from mitsuba_ref.fuzz import findings

    campaign = campaign_of(args)
    if args.examples is not None and not len(args.examples):
        print("nothing selected: --examples 0 selects no example", file=sys.stderr)
        return NOTHING_SELECTED
    if campaign.judge_every or args.candidate is not None:
        from mitsuba_ref.reference import variants

        variants.require_variants()  # a wrong choice of variant fails before any work
    line, finished = StatusLine(), False
    try:
        for done in campaign.run():
            total = done.total
            line.show(f"{total.examples} examples, {total.rays} rays, {total.findings} findings, {done.seconds:.0f} s")
        finished = True
    finally:  # what is found is kept, whatever ends the work
        line.erase()
        print(findings.text(campaign.outcome))
        if args.json:
            write_text(args.json, json.dumps(campaign.outcome.to_dict(interrupted=not finished), indent=1) + "\n")
    return OK if campaign.outcome.ok else DIFFERENCES


def campaign_of(args: argparse.Namespace) -> Campaign:
    """Raises SceneError for an unknown family or candidate."""
    from mitsuba_ref.fuzz.campaign import Campaign
    from mitsuba_ref.hard import FAMILIES
    from mitsuba_ref.subjects.subject import OURS

    families = options.select(FAMILIES, "family", args.family, None) if args.family else FAMILIES
    limit = args.time if args.time is not None or args.examples is not None else DEFAULT_SECONDS
    examples = itertools.count() if args.examples is None else args.examples
    subject = options.requested_candidate(args) or OURS
    kept = (Path(args.out), args.keep, args.judge_every, args.rays)
    return Campaign(args.seed, families, examples, limit, *kept, subject, options.candidate_words(args))


def replay(args: argparse.Namespace) -> int:
    """Check kept scenes again: 0 all pass today, 1 some fail, 2 a file is damaged, 4 missing, 5 an empty folder."""
    from mitsuba_ref.fuzz.cases import kept_files, read_kept
    from mitsuba_ref.fuzz.checks import find
    from mitsuba_ref.fuzz.findings import replay_text
    from mitsuba_ref.subjects.subject import OURS

    files = kept_files(args.replay)
    if not files:
        print(f"nothing selected: no scene file in {args.replay}", file=sys.stderr)
        return NOTHING_SELECTED
    kept = [(str(file), read_kept(file)) for file in files]
    subject = options.requested_candidate(args) or OURS
    replays = [(file, kind, find(case, kind, subject=subject)) for file, (kind, case) in kept]
    print(replay_text(replays))
    return DIFFERENCES if any(findings for *_, findings in replays) else OK

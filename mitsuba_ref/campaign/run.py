"""`mitsuba-ref campaign`: runs the units that the history does not have yet, until they or the budget are used up."""

import argparse
import json
import math
import shlex
import sys
import time
from collections.abc import Generator
from contextlib import closing
from pathlib import Path
from typing import TextIO

from caster.description.errors import SceneError, suggestion
from caster.system.atomic_files import OutputError
from caster.system.process import DIFFERENCES, NOTHING_SELECTED, OK, report_error
from caster.system.terminal import ProgressBar
from mitsuba_ref.campaign.description import Campaign, read_campaign
from mitsuba_ref.campaign.history import BUDGET, COMPLETE, INTERRUPTED, History
from mitsuba_ref.campaign.report import as_html, as_text, keep_scenes, report_of
from mitsuba_ref.campaign.units import SCENE_PLACE, SUBJECT, Result, SubjectError, Unit, ended, run_unit, units_of
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.store import machine
from mitsuba_ref.report.html_report import commit
from mitsuba_ref.report.results import STANDARD_OUTPUT, plural, print_lines, write_output, write_result
from mitsuba_ref.runner.engine import outcomes_of
from mitsuba_ref.runner.verdict_files import code_hash


class CampaignRun:
    """Finishes units one after the other. The history has every finished one at any moment."""

    def __init__(self, history: History, file: str, campaign: Campaign, text: str, units: list[Unit]) -> None:
        """file: of the campaign, and its text. Raises OutputError."""
        self.history, self.file, self.campaign = history, file, campaign
        commit_here = commit(str(Path(file).parent))
        about = {"code": code_hash(), "git": commit_here, "machine": json.dumps(machine()), "campaign": text}
        self.number, self.found = history.begin(units, about)
        self.waiting = [unit for unit in units if unit.key not in self.found]
        self.computed = 0

    def work(self, engine: str, workers: int | None) -> Generator[Result, None, None]:
        """The result of each waiting unit, in their order. Raises SceneError for a subject that cannot be used."""
        state, start, of_key = INTERRUPTED, time.monotonic(), {unit.key: unit for unit in self.waiting}
        rays = sum(row["rays"] for row in self.history.units(self.number))  # of an earlier call
        limits = self.campaign.budget

        def record(result: Result) -> Result:
            unit = of_key[result.key]
            alone = shlex.join(["mitsuba-ref", "campaign", self.file, "--unit", unit.name])
            failures = tuple(each._replace(replay=each.replay or alone) for each in result.failures)
            self.history.record(self.number, unit, result._replace(failures=failures))
            self.computed += 1
            return result

        calls = ((unit,) for unit in self.waiting)
        try:
            with closing(outcomes_of(engine, workers, run_unit, calls, record)) as outcomes:
                for unit in self.waiting:
                    if time.monotonic() - start >= (limits.seconds or math.inf) or rays >= (limits.rays or math.inf):
                        state = BUDGET
                        return
                    outcome = next(outcomes)
                    if isinstance(outcome.error, (OutputError, SubjectError)):
                        raise outcome.error
                    result = outcome.result
                    if outcome.error:
                        result = record(ended(unit, outcome.error))
                    rays += result.rays
                    yield result
            state = COMPLETE
        finally:
            self.history.end(self.number, state)


# ---- the command ----

HISTORY_SUFFIX = ".history.sqlite"


def run(args: argparse.Namespace) -> int:
    """Run a campaign, or read a history; 0 no new failure, 1 some, 5 nothing judged, 130 interrupted."""
    file = Path(args.file)
    if file.suffix.lower() not in (".toml", ".json"):
        if args.unit or args.history:
            raise SceneError(f"{args.file}: expected the campaign file with --unit or --history, got a history")
        with History(file) as history:
            return show(history, args, ran=False)
    campaign, text = read_campaign(args.file)
    units = units_of(campaign)
    variants.require_variants()
    if args.unit:
        for name in (each for each in ("json", "html", "history", "strict") if getattr(args, each)):
            raise SceneError(f"--{name}: not together with --unit, which leaves the history alone")
        return run_one(units, args.unit)
    kept = Path(args.history or file.with_suffix(HISTORY_SUFFIX))
    if args.json == args.html == STANDARD_OUTPUT:
        raise SceneError("--html -: expected a file, since the JSON goes to standard output")
    for option, path in (("--json", args.json), ("--html", args.html)):
        if path and Path(path).resolve() == kept.resolve():
            raise SceneError(f"{option} {path}: expected another file than the history, which it would replace")
    with History(kept, create=True) as history:
        running = CampaignRun(history, args.file, campaign, text, units)
        out = _stream(args)
        found = f"{len(running.found)} in the history, {len(running.waiting)} to compute"
        print_lines(f"{plural(len(units), 'unit')}: {found}", out)
        try:
            with (
                closing(running.work(args.engine, args.workers)) as results,
                closing(ProgressBar("campaign", len(running.waiting))) as bar,
            ):
                for result in results:
                    bar.add(1, result.key)
        finally:  # whatever ends the work, what is finished is kept
            print_lines(f"computed {running.computed}, {len(running.waiting) - running.computed} left", out)
            if not isinstance(sys.exc_info()[1], SceneError):  # a mistake, whose message comes last
                code = show(history, args, ran=True)
    return code


def _stream(args: argparse.Namespace) -> TextIO:
    """For text: standard error if the JSON or the page goes to standard output."""
    return sys.stderr if STANDARD_OUTPUT in (args.json, args.html) else sys.stdout


def show(history: History, args: argparse.Namespace, *, ran: bool) -> int:
    """Print the report on the last run and write its files; the exit code. ran: now, so that its scenes are kept."""
    found, scenes = report_of(history)
    try:
        keep_scenes(history, scenes)
    except OutputError as error:
        if ran:
            raise
        print(f"without the scenes of replays: {error}", file=sys.stderr)
    print_lines(f"\n{as_text(found)}", _stream(args))
    write_result(found, args.json)
    if args.html:
        write_output(as_html(found), args.html)
    if found.new or (args.strict and found.standing):
        return DIFFERENCES
    if not found.runs or not found.runs[-1].rays:
        return report_error("nothing judged: no unit of the last run has a ray", NOTHING_SELECTED)
    return OK


def run_one(units: list[Unit], name: str) -> int:
    """Run one unit in this process, without the history; 1 if it fails. Raises SceneError for an unknown name."""
    names = {unit.name: unit for unit in units}
    if name not in names:
        hint = suggestion(name, names) or f"; the first of {len(names)} is '{units[0].name}'"
        raise SceneError(f"--unit {name!r}: the campaign has no such unit{hint}")
    result = run_unit(names[name])
    counts = ", ".join(f"{key} {value:g}" for key, value in result.counts.items())
    print_lines(f"{name}: {result.rays} rays, {result.hits} hits, {result.agree} agree; {counts}")
    for each in result.failures:
        replay = f"{each.replay.replace(SCENE_PLACE, 'scene.toml')}\n{each.scene}".rstrip()  # the scene follows, if any
        print_lines(f"{each.side}: {each.cause} ({each.times}): {each.what}\n      replay: {replay}")
    return DIFFERENCES if any(each.side == SUBJECT for each in result.failures) else OK

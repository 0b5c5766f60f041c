"""`mitsuba-ref campaign`: runs the units that the history does not have yet, until they or the budget are used up."""

import json
import math
import os
import shlex
import sys
import time
from argparse import Namespace
from collections.abc import Generator
from contextlib import closing
from pathlib import Path

from caster.description.errors import SceneError, suggestion
from caster.system.atomic_files import OutputError, write_text
from caster.system.process import DIFFERENCES, NOTHING_SELECTED, OK, report_error
from caster.system.terminal import ProgressBar
from mitsuba_ref.campaign.description import Budget, read_campaign
from mitsuba_ref.campaign.history import BUDGET, COMPLETE, INTERRUPTED, History
from mitsuba_ref.campaign.report import as_html, as_text, keep_scenes, report_of
from mitsuba_ref.campaign.units import SCENE_PLACE, SUBJECT, Result, SubjectError, Unit, ended, run_unit, units_of
from mitsuba_ref.cli.options import refuse, table_stream
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.store import machine
from mitsuba_ref.report.html_report import commit
from mitsuba_ref.report.output import plural, print_lines, write_result
from mitsuba_ref.runner.engine import outcomes_of
from mitsuba_ref.runner.verdict_files import code_hash

HISTORY_SUFFIX = ".history.sqlite"


def run_campaign(args: Namespace) -> int:
    """Run a campaign, or read a history; 0 no new failure, 1 some, 5 nothing judged, 130 interrupted."""
    file = Path(args.file)
    if file.suffix.lower() not in (".toml", ".json"):
        if args.unit or args.history:
            raise SceneError(f"{args.file}: expected the campaign file with --unit or --history, got a history")
        with History(file) as history:
            return show(history, args)
    campaign, text = read_campaign(args.file)
    units = units_of(campaign)
    variants.require_variants()
    if args.unit:
        refuse(args, "not together with --unit, which leaves the history alone", "json", "html", "history", "strict")
        return run_one(units, args.unit)
    kept = Path(args.history or file.with_suffix(HISTORY_SUFFIX))
    for option, path in (("--json", args.json), ("--html", args.html)):
        if path and os.path.realpath(path) == os.path.realpath(kept):
            raise SceneError(f"{option} {path}: expected another file than the history, which it would replace")
    with History(kept, create=True) as history:
        about = {
            "code": code_hash(),
            "git": commit(str(file.parent)),
            "machine": json.dumps(machine()),
            "campaign": text,
        }
        number, found = history.begin(units, about)
        waiting, out = [unit for unit in units if unit.key not in found], table_stream(args)
        print_lines(f"{plural(len(units), 'unit')}: {len(found)} in the history, {len(waiting)} to compute", out)
        try:
            with (
                closing(results_of(waiting, history, number, campaign.budget, args)) as results,
                closing(ProgressBar("campaign", len(waiting))) as bar,
            ):
                for result in results:
                    bar.add(1, result.key)
        finally:  # whatever ends the work, what is finished is kept
            computed = len(history.units(number)) - len(found)
            print_lines(f"computed {computed}, {len(waiting) - computed} left", out)
            if not isinstance(sys.exc_info()[1], SceneError):  # a mistake, whose message comes last
                code = show(history, args)
    return code


def results_of(
    waiting: list[Unit], history: History, run: int, budget: Budget, args: Namespace
) -> Generator[Result, None, None]:
    """The results of units, in their order, each as soon as the history has it; ends where the budget is used up.

    Raises SceneError for a subject that cannot be used.
    """
    state, start, of_key = INTERRUPTED, time.monotonic(), {unit.key: unit for unit in waiting}
    rays = sum(row["rays"] for row in history.units(run))  # of an earlier call

    def record(result: Result) -> Result:
        unit = of_key[result.key]
        alone = shlex.join(["mitsuba-ref", "campaign", args.file, "--unit", unit.name])
        failures = tuple(each._replace(replay=each.replay or alone) for each in result.failures)
        history.record(run, unit, result._replace(failures=failures))
        return result

    calls = ((unit,) for unit in waiting)
    try:
        with closing(outcomes_of(args.engine, args.workers, run_unit, calls, record)) as outcomes:
            for unit in waiting:
                if time.monotonic() - start >= (budget.seconds or math.inf) or rays >= (budget.rays or math.inf):
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
        history.end(run, state)


def show(history: History, args: Namespace) -> int:
    """Print the report on the last run and write its files; the exit code. Raises OutputError."""
    found, scenes = report_of(history)
    print_lines(f"\n{as_text(found)}", table_stream(args))
    write_result(found, args.json)
    if args.html:
        write_text(args.html, as_html(found))
    keep_scenes(history, scenes)
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

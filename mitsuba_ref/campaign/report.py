"""The report of a campaign: what is new since the last run, trends over runs, and the reference's own defects."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field, replace
from html import escape
from pathlib import Path

from pydantic import computed_field
from pydantic.dataclasses import dataclass

from caster.system.atomic_files import check_folder, write_text
from mitsuba_ref.campaign.history import History, Row
from mitsuba_ref.campaign.units import REFERENCE, SCENE_PLACE, SUBJECT
from mitsuba_ref.reference.store import key_of
from mitsuba_ref.report.output import aligned, plural

LISTED = 20  # of each list in text and on the page; the JSON has all
FOLDER_SUFFIX, NAME_DIGITS = ".failures", 12  # of the folder of scenes, beside the history, and of their names


@dataclass(frozen=True)
class RunSummary:
    """One run, with what it found in the history."""

    run: int
    state: str
    started: str
    git: str
    code: str
    machine: dict[str, str]
    requested: int  # units
    units: int  # of them, finished
    computed: int  # by this run, not by an earlier one
    failing: int  # units
    rays: int
    hits: int
    agree: int


@dataclass(frozen=True)
class ReportedFailure:
    """Wrong answers of one kind in a unit, or in several."""

    unit: str  # the first of them
    group: str  # its subject, kind and family
    cause: str
    what: str
    times: int
    replay: str
    units: int = 1


@dataclass(frozen=True)
class TrendPoint:
    """One subject and family in one run."""

    run: int
    units: int
    failing: int
    rays: int
    agree: int  # of them
    rays_per_second: float


@dataclass(frozen=True)
class CampaignReport:
    """The last run beside the earlier ones."""

    history: str
    runs: tuple[RunSummary, ...]
    new: tuple[ReportedFailure, ...] = ()  # not in the last run that had the unit
    standing: tuple[ReportedFailure, ...] = ()  # there, too
    gone: tuple[ReportedFailure, ...] = ()  # there alone
    trends: dict[str, tuple[TrendPoint, ...]] = field(default_factory=dict)
    defects: tuple[ReportedFailure, ...] = ()  # of the reference, each case once

    @computed_field  # type: ignore[prop-decorator]
    @property
    def ok(self) -> bool:
        """Nothing is wrong that was not wrong in the last run."""
        return not self.new


RUNS = (
    "SELECT runs.id AS run, state, started, git, code, machine, runs.units AS requested, count(key) AS units, "
    "total(computed_by = runs.id) AS computed, total(failing > 0) AS failing, total(rays) AS rays, "
    "total(hits) AS hits, total(agree) AS agree FROM runs LEFT JOIN run_units ON run = runs.id "
    "LEFT JOIN units USING (key) GROUP BY runs.id ORDER BY runs.id"
)


def report_of(history: History) -> tuple[CampaignReport, dict[Path, str]]:
    """The report on the last run, and the scene files that its replays name. Raises OutputError."""
    scenes: dict[Path, str] = {}
    runs = tuple(RunSummary(**row | {"machine": json.loads(row["machine"])}) for row in history.rows(RUNS))
    if not runs:
        return CampaignReport(str(history.path), ()), scenes
    last = runs[-1].run
    now = {row["name"] for row in history.units(last)}
    wrong, before = history.failures(SUBJECT, last), history.failures(SUBJECT, last, before=True)
    was_wrong = {place: each for place, each in before.items() if each["name"] in now}
    cases: dict[str, list[Row]] = {}
    for each in history.failures(REFERENCE, last).values():
        cases.setdefault(each["cause"], []).append(each)
    folder = history.path.with_suffix(FOLDER_SUFFIX)

    def reported(each: Row) -> ReportedFailure:
        replay = each["replay"]
        if each["scene"] and SCENE_PLACE in replay:
            file = folder / f"{key_of([each['key'], each['cause']])[:NAME_DIGITS]}.toml"
            scenes[file] = each["scene"]
            replay = replay.replace(SCENE_PLACE, str(file))
        return ReportedFailure(each["name"], each["grouped"], each["cause"], each["what"], each["times"], replay)

    def of_case(found: list[Row]) -> ReportedFailure:
        smallest = min(found, key=lambda each: (not each["scene"], len(each["scene"]), each["name"]))
        return replace(reported(smallest), times=sum(each["times"] for each in found), units=len(found))

    report = CampaignReport(
        str(history.path),
        runs,
        tuple(reported(each) for place, each in wrong.items() if place not in was_wrong),
        tuple(reported(each) for place, each in wrong.items() if place in was_wrong),
        tuple(reported(each | {"scene": ""}) for place, each in was_wrong.items() if place not in wrong),
        _trends(history),
        tuple(of_case(found) for _, found in sorted(cases.items())),
    )
    return report, scenes


def keep_scenes(history: History, scenes: Mapping[Path, str]) -> None:
    """Write the scenes of a report that are not there yet. Raises OutputError."""
    for file, text in scenes.items():
        if not file.exists():
            check_folder(history.path.with_suffix(FOLDER_SUFFIX))
            write_text(file, text)


def _trends(history: History) -> dict[str, tuple[TrendPoint, ...]]:
    found: dict[str, tuple[TrendPoint, ...]] = {}
    for row in history.rows(
        "SELECT grouped, run, count(*) AS units, total(failing > 0) AS failing, total(rays) AS rays, "
        "total(agree) AS agree, coalesce(round(sum(rays) / sum(seconds), 1), 0) AS rays_per_second "
        "FROM run_units JOIN units USING (key) GROUP BY grouped, run ORDER BY grouped, run"
    ):
        group = row.pop("grouped")
        found[group] = (*found.get(group, ()), TrendPoint(**row))
    return found


# ---- text ----


def as_text(report: CampaignReport) -> str:
    """What is new, then the trends, then the reference's wrong answers."""
    return "\n\n".join(_parts(report))


def _parts(report: CampaignReport) -> list[str]:
    """The last run and what changed; the trends; wrong answers of the reference, if any."""
    if not report.runs:
        return [f"{report.history}: no run yet"]
    changes = {"new failures": report.new, "failures gone": report.gone, "failures as before": report.standing}
    last = report.runs[-1]
    numbers = f"{last.computed} computed by it, {last.rays} rays, {last.hits} hits"
    failures = f"{last.failing} fail, {plural(len(report.new), 'new failure')}, {len(report.gone)} gone"
    head = f"run {last.run}, {last.state}: {last.units} of {plural(last.requested, 'unit')}, {numbers}; {failures}"
    parts = [head, *(_listed(title, each, merged(each)) for title, each in changes.items() if each)]
    rows = (
        (group, *map(str, (at.run, at.units, at.failing, at.rays, at.agree, round(at.rays_per_second))))
        for group, points in report.trends.items()
        for at in points
    )
    trends = "\n".join(aligned([TREND_COLUMNS, *rows], left=1))
    wrong = [_listed("wrong answers of the reference", report.defects, report.defects)] if report.defects else []
    return ["\n\n".join(parts), trends, *wrong]


TREND_COLUMNS = ("subject, kind and family", "run", "units", "fail", "rays", "agree", "rays/s")


def _listed(title: str, failures: Sequence[ReportedFailure], shown: Sequence[ReportedFailure]) -> str:
    """The number of failures, and those that are shown in their place."""
    lines = [f"{title}: {len(failures)}"]
    for each in shown[:LISTED]:
        many = f" ({each.times} in {plural(each.units, 'unit')})" if each.times > 1 else ""
        more = each.what.partition("\n")[0], f"replay: {each.replay}" if each.replay else ""
        lines += [f"  {each.cause}{many}: {each.unit}", *(f"      {line}" for line in more if line)]
    lines += [f"  and {len(shown) - LISTED} more, which --json has"] if len(shown) > LISTED else []
    return "\n".join(lines)


def merged(failures: Iterable[ReportedFailure]) -> list[ReportedFailure]:
    """Failures of one subject, kind, family and cause as one, in the order of the first of each."""
    found: dict[tuple[str, str], ReportedFailure] = {}
    for each in failures:
        first = found.setdefault((each.group, each.cause), replace(each, times=0, units=0))
        found[each.group, each.cause] = replace(first, times=first.times + each.times, units=first.units + each.units)
    return list(found.values())


# ---- page ----

STYLE = """body { font: 14px/1.45 system-ui, sans-serif; max-width: 70em; margin: 2em auto; padding: 0 1em; }
h1 { font-size: 18px; } pre { white-space: pre-wrap; } table { border-collapse: collapse; } svg { display: block; }
td, th { padding: 3px 10px; text-align: left; border-bottom: 1px solid #8884; }
polyline { fill: none; stroke: currentColor; stroke-width: 1.5; } circle { fill: currentColor; }"""
WIDTH, HEIGHT, MARGIN = 180, 36, 4  # of a plot, pixels


def as_html(report: CampaignReport) -> str:
    """The text, and the trends as plots: a page that needs no other file."""
    title = escape(f"Campaign {report.history}")
    changes, *rest = (f"<pre>{escape(part)}</pre>" for part in _parts(report))
    plots = "".join(
        f"<tr><td>{escape(group)}<td>{_plot([at.failing for at in points])}"
        f"<td>{_plot([at.rays_per_second for at in points])}"
        for group, points in report.trends.items()
    )
    table = f"<table><tr><th>{TREND_COLUMNS[0]}<th>fail<th>rays/s{plots}</table>" if plots else ""
    head = f"<html lang=en><meta charset=utf-8><title>{title}</title><style>{STYLE}</style><h1>{title}</h1>"
    return f"<!doctype html>{head}{changes}{table}{''.join(rest)}</html>\n"


def _plot(values: Sequence[float]) -> str:
    """A line over the runs, from zero up to the largest value."""
    top, steps = max(values) or 1.0, max(1, len(values) - 1)
    points = [
        f"{MARGIN + (WIDTH - 2 * MARGIN) * i / steps:.1f},{HEIGHT - MARGIN - (HEIGHT - 2 * MARGIN) * value / top:.1f}"
        for i, value in enumerate(values)
    ]
    x, _, y = points[-1].partition(",")
    words = ", ".join(f"{value:.0f}" for value in values)
    line = f'<polyline points="{" ".join(points)}"/><circle cx="{x}" cy="{y}" r="2.5"/>'
    return f'<svg width="{WIDTH}" height="{HEIGHT}" role="img" aria-label="{words}">{line}</svg>'

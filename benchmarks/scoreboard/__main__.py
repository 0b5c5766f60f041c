"""Judge the casters of casters.toml and write docs/findings/scoreboard.md; or replay one ray of one of them.

python -m scoreboard [--only NAME ...] [--build build/scoreboard] [--docs docs]
python -m scoreboard --replay CASTER COLUMN X RAY
"""

import argparse
import json
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from caster.system.atomic_files import write_text
from caster.system.process import DIFFERENCES, NOTHING_SELECTED, OK
from mitsuba_ref.bench.machine import machine_properties
from mitsuba_ref.reference.subprocess_runner import ProcessEnded
from mitsuba_ref.subjects.command import served
from mitsuba_ref.subjects.requests import parse_candidate
from mitsuba_ref.subjects.subject import Answer, NoAnswer

from . import judging, page, roster
from .judging import Cell
from .roster import Entry, NotInstalledError

OURS = "ours"


def subject_of(entry: Entry, build: Path) -> judging.ServedCommand:
    """The program that serves a caster. Raises NotInstalledError."""
    found = parse_candidate(roster.command(entry, build), entry.precision, judging.SECONDS, served=True)
    return replace(found, takes_limits=entry.limits)


def closed(subject: judging.ServedCommand) -> None:
    if process := served.pop(subject.words, None):
        process.close()


def result_of(entry: Entry, ours: judging.ServedCommand, build: Path) -> dict[str, Any]:
    """All that is known of one caster, as the page and the JSON file have it."""
    found: dict[str, Any] = {"name": entry.name, "absent": "", "cells": []}
    try:
        subject = subject_of(entry, build)
        found["version"] = roster.version(entry, build)
    except NotInstalledError as why:
        return found | {"absent": f"not installed: {why}"}
    cells, known = list[Cell](), set[tuple[str, bool, bool]]()
    for cell, answer in judging.judged(subject, entry.rays):
        print(f"  {cell.column} {cell.x}: {cell.absent or cell.wrong}", file=sys.stderr)
        if (cell.column, cell.x) == judging.ULPS_AT and isinstance(answer, Answer):
            found["ulps"] = judging.ulps(answer, entry.rays)
        kind = cell.column, bool(cell.wrong), bool(cell.absent)  # one for t, one for normals, one for a crash
        if cell.first is not None and kind not in known:
            known.add(kind)
            again, lines = judging.reproduced(subject, cell, cell.first, entry.rays)
            words = f"--replay {entry.name} {cell.column} {cell.x} {cell.first}"
            note = [] if again else ["not wrong again"]
            cell = replace(cell, reproducer="\n".join([f"python -m scoreboard {words}", *lines, *note]))
        cells.append(cell)
    found["cells"] = [asdict(each) for each in cells]
    try:
        found["limits"] = judging.limits(subject)
        (ours_rate, _), (rate, memory) = judging.speeds([ours, subject])
        found |= {"rate": rate, "ours_rate": ours_rate, "memory": memory}
    except (ProcessEnded, NoAnswer):
        found["limits"] = found.get("limits", "no answer")
    closed(subject)
    return found


def run(args: argparse.Namespace) -> int:
    known = roster.entries()
    ours = subject_of(known[0], args.build)
    file = args.build / "results.json"
    found = {each["name"]: each for each in json.loads(file.read_text())["casters"]} if args.only else {}
    for entry in known:
        if args.only is None or entry.name in args.only:
            print(entry.name, file=sys.stderr)
            found[entry.name] = result_of(entry, ours, args.build)
        there = [found[each.name] for each in known if each.name in found]
        write_text(file, json.dumps({"machine": machine_properties(), "casters": there}, indent=1))
    page.write(file, args.docs)
    return OK


def replay(args: argparse.Namespace) -> int:
    name, column, x, ray = args.replay
    entry = next((entry for entry in roster.entries() if entry.name == name), None)
    place = next((each for each in judging.settings() if each[0] == column and f"{each[1]}" == x), None)
    if entry is None or place is None:
        print(f"--replay: no caster {name}, or no setting {column} {x}", file=sys.stderr)
        return NOTHING_SELECTED
    subject = subject_of(entry, args.build)
    again, lines = judging.reproduced(subject, Cell(*place, 1), int(ray), entry.rays)
    closed(subject)
    print(*lines, sep="\n")
    return DIFFERENCES if again else OK


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m scoreboard", description=__doc__)
    names = [entry.name for entry in roster.entries()]
    parser.add_argument("--only", nargs="+", choices=names, help="renew these alone")
    parser.add_argument("--build", type=Path, default=Path("build/scoreboard"), help="what is installed, results.json")
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="where findings/scoreboard.md is written")
    parser.add_argument("--replay", nargs=4, metavar=("CASTER", "COLUMN", "X", "RAY"), help="one ray of a cell")
    args = parser.parse_args()
    args.build = args.build.absolute()
    return replay(args) if args.replay else run(args)


if __name__ == "__main__":
    sys.exit(main())

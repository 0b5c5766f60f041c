"""`mitsuba-ref bench`: run time against error, of ours, of Mitsuba and of others."""

from __future__ import annotations

import argparse
import json
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from caster.cli.exit_codes import DIFFERENCES, NOTHING_SELECTED, OK
from caster.description.errors import FileMissing, SceneError
from mitsuba_ref.cli.options import check_report, positive_int
from mitsuba_ref.cli.stress import Progress, seed

if TYPE_CHECKING:
    from mitsuba_ref.bench.result import Run, SceneResult
    from mitsuba_ref.bench.run import BenchmarkRun

SIZE, ALTERNATIONS = 1024, 7


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("scenes", metavar="SCENE", nargs="*", help="such as mesh-70k; default: all that --list names")
    add("-k", metavar="EXPR", dest="expression", help="scenes whose name fits, such as 'mesh and not lit'")
    add("--list", action="store_true", help="say which scenes there are, and stop")
    add(
        "--peers",
        action="store_true",
        help="ask Open3D, embreex and trimesh, too; pip install 'ray-reference[peers]'",
    )
    add("--size", metavar="N", type=positive_int, default=SIZE, help=f"pixels a side; default: {SIZE}")
    add(
        "--alternations",
        metavar="N",
        type=positive_int,
        default=ALTERNATIONS,
        help=f"turns of each; default: {ALTERNATIONS}, and a report with fewer says so",
    )
    add("--threads", metavar="N", type=positive_int, help="processors that each may use; default: all")
    add(
        "--seed",
        metavar="S",
        type=seed,
        default=0,
        help="of the rays that errors are measured on; default: 0",
    )
    add(
        "--sweeps",
        action="store_true",
        help="also time against triangles, pixels and threads, as --report does",
    )
    add(
        "--json",
        metavar="FILE",
        help="write the result as JSON; - is standard output, which then holds nothing else",
    )
    add(
        "--report",
        metavar="DIR",
        help="write performance.md and its pictures into this folder; times everything",
    )
    add("--from", metavar="FILE", dest="before", help="time nothing: tell a run that --json wrote before")


def run(args: argparse.Namespace) -> int:
    """Time what was selected; 0, 1 where ours did not run, 2 unknown scene, 5 nothing selected, 130 interrupted."""
    from mitsuba_ref.bench.scenes import select_scenes

    scenes = select_scenes(args.scenes, args.expression)
    if not scenes:
        print(f"nothing selected: no scene fits -k {args.expression!r}", file=sys.stderr)
        return NOTHING_SELECTED
    if args.list:
        print("\n".join(f"{scene.name:18}{scene.title}" for scene in scenes))
        return OK
    check_report(args.json, args.report)
    if args.before:
        return again(args)
    from mitsuba_ref.bench.contestants import processors
    from mitsuba_ref.bench.measuring import Settings
    from mitsuba_ref.bench.run import BenchmarkRun

    threads = args.threads or processors()
    if threads > processors():
        raise SceneError(f"--threads {threads}: this process may use {processors()}")
    settings = Settings(args.size, args.alternations, threads, args.seed, args.peers)
    work = BenchmarkRun(scenes, settings)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # a cancelled job tidies up as after Ctrl-C
    try:
        work_through(work, args)
    finally:  # what is done is kept, whatever ends the work
        report(work.run, args)
    return OK if all(ran(scene) for scene in work.run.scenes) else DIFFERENCES


def ran(scene: SceneResult) -> bool:
    """Whether each of our rows has numbers, or says why it is not asked."""
    return all(row.ran or row.why.startswith("not asked") for row in scene.rows if row.side == "ours")


def work_through(work: BenchmarkRun, args: argparse.Namespace) -> None:
    """Print each scene's table as soon as it is done."""
    from mitsuba_ref.bench.run import FAMILIES

    say = Progress("bench")
    work.time_scenes(say, lambda scene: show(scene, say, args))
    if args.sweeps or args.report:
        work.sweep(FAMILIES, say)
    say.clear()


def show(scene: SceneResult, say: Progress, args: argparse.Namespace) -> None:
    from mitsuba_ref.bench import table

    say.clear()
    print(f"{table.as_text(scene)}\n", file=spoken(args), flush=True)


def again(args: argparse.Namespace) -> int:
    """Tables and report of an earlier run."""
    from mitsuba_ref.bench.result import from_json

    try:
        before = from_json(json.loads(Path(args.before).read_text(encoding="utf-8")))
    except OSError as error:
        raise FileMissing(f"{args.before}: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        text = f"{args.before}: expected what `mitsuba-ref bench --json` writes, got something else"
        raise SceneError(text) from error
    silent = Progress("bench")
    for scene in before.scenes:
        show(scene, silent, args)
    report(before, args)
    return OK


def report(done: Run, args: argparse.Namespace) -> None:
    """The files that were asked for, and a last line."""
    from caster.image.atomic_files import write_text
    from mitsuba_ref.bench.page import write_report
    from mitsuba_ref.bench.result import as_json
    from mitsuba_ref.bench.table import summary

    if args.json:
        text = json.dumps(as_json(done), indent=1, allow_nan=False) + "\n"
        if args.json == "-":
            sys.stdout.write(text)
        else:
            write_text(args.json, text)
    if args.report:
        write_report(done, Path(args.report))
    print(summary(done), file=spoken(args))


def spoken(args: argparse.Namespace) -> TextIO:
    """Where tables go: a program that reads JSON from standard output is to find nothing else there."""
    return sys.stderr if args.json == "-" else sys.stdout

"""`mitsuba-ref validate`: the main job, scene by scene."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import time
from collections.abc import Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from caster.cli.exit_codes import DIFFERENCES, NOTHING_SELECTED, OK
from caster.cli.scene_arguments import (
    add_mesh_dirs,
    display_names,
    error_prefix,
    mesh_dir_options,
    scene_files,
)
from caster.description.errors import SceneError
from mitsuba_ref.cli import candidate_options, html_option
from mitsuba_ref.cli import output_options as ci

if TYPE_CHECKING:
    from mitsuba_ref.judge.verdict import SceneVerdict, Verdict
    from mitsuba_ref.report.html.html_report import HtmlReport
    from mitsuba_ref.runner.resume import OutFolder
    from mitsuba_ref.runner.scene_runner import SceneEntry
    from mitsuba_ref.subjects.subject import Candidate


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("scenes", metavar="SCENE|DIR", nargs="*", default=["scenes"], help="default: the folder scenes")
    add("-k", metavar="EXPR", dest="expression", help="scenes whose name fits, such as 'mesh and not teapot'")
    add("-j", metavar="N", dest="workers", type=count, help="scenes at a time; default: one a core")
    add("--size", nargs=2, type=int, metavar=("W", "H"), help="film in pixels, instead of the scenes' own")
    add("--out", metavar="DIR", help="write verdict.json, EXR files and reproducers into this folder")
    add("--json", metavar="FILE", help="write the verdict as JSON")
    add("--junit", metavar="FILE", help="write the verdict as JUnit XML")
    html_option.add(parser)
    add("--maxfail", metavar="N", type=count, help="stop after so many scenes that fail")
    add_mesh_dirs(parser)
    candidate_options.add_arguments(parser)
    ci.add_arguments(parser)


def count(text: str) -> int:
    """A whole number >= 1, or an error in argparse's way."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number >= 1, got '{text}'")
    return int(text)


def run(args: argparse.Namespace) -> int:
    """Validate what was selected; 0 all pass, 1 some do not, 5 nothing was selected, 130 interrupted."""
    entries = selected(args)
    if not entries:
        fits = f" that fits -k {args.expression!r}" if args.expression else ""
        print(f"nothing selected: no scene file{fits} in {', '.join(args.scenes)}", file=sys.stderr)
        return NOTHING_SELECTED
    check_outputs(args)
    every = entries
    entries = ci.part_of(entries, args)
    candidate = candidate_options.asked(args)  # one that cannot be asked is said before any work
    from mitsuba_ref.reference import variants

    variants.variant_for(has_quadrics=False)  # a wrong choice of variant is said before any work
    start = time.perf_counter()
    done: list[SceneVerdict] = []
    out = ci.out_folder(args)
    html = html_option.begun(args, len(entries), candidate.name if candidate else "")
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # a cancelled job tidies up as after Ctrl-C
    try:
        work_through(entries, args, done, html, candidate, out)
    finally:  # what is done is kept, whatever ends the work
        from mitsuba_ref.judge.verdict import Verdict

        names = tuple(entry.name for entry in entries)
        verdict = Verdict(
            tuple(done),
            asked=len(entries),
            names=names,
            on_trial=candidate.name if candidate else "",
            **ci.about(args, every),
        )
        try:
            report(verdict, args, time.perf_counter() - start)
            names = tuple(entry.name for entry in every)
            if out and (words := out.sweep(verdict, names if is_whole(args) else None).words(out.folder)):
                print(words, file=sys.stderr)
        finally:
            html_option.finish(html, verdict.not_judged)
    return OK if verdict.ok else DIFFERENCES


def is_whole(args: argparse.Namespace) -> bool:
    """Whether all scenes of folders were asked for, so that others are gone."""
    return not args.expression and all(Path(place).is_dir() for place in args.scenes)


def selected(args: argparse.Namespace) -> list[SceneEntry]:
    """The scenes, loaded. Raises SceneError with all that is wrong with all of them."""
    from mitsuba_ref.runner.scene_selection import matching

    fits = matching(args.expression)
    files = [file for file in scene_files(args.scenes) if fits(Path(file).stem)]
    entries, errors = [], []
    for file, name in zip(files, display_names(files), strict=True):
        try:
            entries.append(entry(file, name, args))
        except SceneError as error:
            errors.append(error)
    if errors:
        worst = min(errors, key=lambda error: error.exit_code)
        raise type(worst)("\n".join(map(str, errors)))
    return entries


def entry(file: str, name: str, args: argparse.Namespace) -> SceneEntry:
    from caster.scene.files import load_scene
    from mitsuba_ref.runner.scene_runner import SceneEntry

    scene = load_scene(file, args.mesh_dir)
    if args.size:
        with error_prefix("--size", *args.size):
            scene = scene.with_film(width=args.size[0], height=args.size[1])
    options = (*mesh_dir_options(args), *candidate_options.again(args))
    return SceneEntry(scene, name, file, resized=bool(args.size), options=options)


def check_outputs(args: argparse.Namespace) -> None:
    """Raise OutputError now, and not after all the work."""
    from caster.image.atomic_files import check_folder, check_writable

    if args.out:
        check_folder(args.out)
    for path in filter(None, (args.json, args.junit)):
        check_writable(path)
    ci.check_outputs(args)


def work_through(
    entries: Sequence[SceneEntry],
    args: argparse.Namespace,
    done: list[SceneVerdict],
    html: HtmlReport | None,
    candidate: Candidate | None,
    out_folder: OutFolder | None,
) -> None:
    """Print a row for each scene as soon as it and those before it are done. candidate: in the place of ours."""
    from mitsuba_ref.report import terminal
    from mitsuba_ref.runner import scene_progress, scene_runner

    width = max((len(each.name) for each in entries), default=0)
    # Itself, since whoever reads an EXR file in another thread puts another one in its place meanwhile.
    out = sys.stdout
    print(terminal.table_head(width), file=out, flush=True)
    folder = Path(args.out) if args.out else None
    workers = args.workers or scene_runner.default_workers()
    record = html.keep if html else None
    if candidate is None:
        judge = ci.judge_of(args, partial(scene_runner.judge_entry, keep=html is not None), out_folder, html)
    else:
        judge = candidate_options.judge_of(candidate, keep=html is not None)
        judge = out_folder.recorded(judge) if out_folder else judge
    if out_folder:
        out_folder.begin()
    with closing(scene_progress.bar_for(entries)) as bar:
        for verdict in scene_runner.run(entries, workers, args.maxfail, folder, judge, record):
            done.append(verdict)
            if html:
                html.add(verdict)
            with bar.aside():
                print(terminal.table_row(verdict, width), file=out, flush=True)
            scene_progress.count(bar, entries, len(done))


def report(verdict: Verdict, args: argparse.Namespace, seconds: float) -> None:
    """The files that were asked for, what failed and why, and the summary."""
    from caster.image.atomic_files import write_text
    from mitsuba_ref.report import terminal
    from mitsuba_ref.report.junit import junit

    text = json.dumps(verdict.to_dict(), indent=1, allow_nan=False) + "\n"
    for path in filter(None, (args.json, args.out and Path(args.out) / "verdict.json")):
        write_text(path, text)
    if not verdict.not_judged:
        ci.close(args)
    if args.junit:
        write_text(args.junit, junit(verdict))
    ci.report(verdict, args, seconds)
    for scene in verdict.scenes:
        if not scene.ok:
            print(f"\n{terminal.failure_text(scene, html_option.page_of(args))}")
    print(f"\n{terminal.summary_text(verdict, seconds)}")

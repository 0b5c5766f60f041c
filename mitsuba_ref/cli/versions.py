"""`mitsuba-ref versions`: the same scenes judged with two versions of Mitsuba."""

import argparse

from caster.description.errors import SceneError
from caster.system.process import DIFFERENCES, NOTHING_SELECTED, OK
from mitsuba_ref.cli.options import Progress, check_json, table_stream
from mitsuba_ref.cli.validate import selected_entries
from mitsuba_ref.reference import variants
from mitsuba_ref.reference.interpreter import chosen, interpreter
from mitsuba_ref.reference.store import machine
from mitsuba_ref.report.results import print_lines, write_result
from mitsuba_ref.runner.version_comparison import (
    LEGEND,
    SceneComparison,
    VersionComparison,
    compare_scene,
    scene_text,
    summary_text,
)


def run(args: argparse.Namespace) -> int:
    """Print what changed; 1 if a scene passes with one version alone, 5 nothing was selected. Raises SceneError."""
    pythons = args.interpreters if len(args.interpreters) == 2 else [interpreter(), *args.interpreters]
    if len(pythons) != 2:
        raise SceneError(f"--mitsuba: expected it once or twice, got {len(args.interpreters)}")
    entries = selected_entries(args)
    if not entries:
        return NOTHING_SELECTED
    check_json(args)
    versions = []
    for python in pythons:  # their errors come before any work
        with chosen(python):
            variants.require_variants()
            versions.append({name: machine()[name] for name in ("mitsuba", "drjit")})
    out = table_stream(args)
    print(f"{LEGEND}\n", file=out)
    done: list[SceneComparison] = []
    try:
        for i, entry in enumerate(entries):
            progress = Progress(f"versions: {i + 1}/{len(entries)} {entry.name}")
            progress("judging")
            done.append(compare_scene(pythons, entry.load(), entry.name, entry.path, args.timeout))
            progress.clear()
            print_lines(f"{scene_text(done[-1])}\n", out)
    finally:  # what is done is kept, whatever ends the work
        found = VersionComparison(tuple(pythons), tuple(versions), tuple(done))
        if args.json:
            write_result(found, args.json)
        print_lines(summary_text(found), out)
    return OK if found.ok else DIFFERENCES

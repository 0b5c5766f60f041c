"""`mitsuba-ref compare`: two EXR files, or the files of the same names in two folders."""

import json
import sys
from argparse import Namespace
from dataclasses import replace
from glob import glob
from pathlib import Path
from typing import Any

from caster.description.errors import SceneError
from caster.scene.files import load_scene
from caster.system.process import NOTHING_SELECTED, OK
from caster.system.terminal import folded
from mitsuba_ref.cli.arguments import NUMBERS
from mitsuba_ref.cli.options import NothingSelected, reading_of, report_address
from mitsuba_ref.exr_compare.comparison_result import FileComparison
from mitsuba_ref.exr_compare.two_files import Reading, Tolerances, compare_exr
from mitsuba_ref.report.output import plural, print_lines


def run_compare(args: Namespace) -> int:
    """Print the comparison; 0 pass, 1 differences, 2 unclear, 3 not comparable, 4 missing, 5 nothing to compare."""
    names = (*NUMBERS, "max_pixels", "other_scene")
    tolerances = Tolerances(**{name: getattr(args, name) for name in names}, ignore=tuple(args.ignore))
    reading = replace(reading_of(args), scene=load_scene(args.scene) if args.scene else None)
    folders = [path for path in (args.ours, args.reference) if Path(path).is_dir()]
    if len(folders) == 2:
        return compare_folders(args, tolerances, reading)
    if folders:
        raise SceneError(f"expected two files, or two folders; only {folders[0]} is a folder")
    result = compare_exr(args.ours, args.reference, tolerances, html=args.html, reading=reading)
    print(result.model_dump_json(indent=2) if args.json else folded(str(result)))
    if args.html and not args.json:
        none = "report:     none, as nothing could be compared; an earlier one there is removed"
        print(f"\n{report_address(result.html) if result.html else none}")
    return result.exit_code


def compare_folders(args: Namespace, tolerances: Tolerances, reading: Reading) -> int:
    """Compare every EXR file in the reference's folder and its subfolders.

    Returns the highest exit code, but 5 only without another failure.
    """
    if args.html:
        raise SceneError("--html: expected two files, not folders")
    folders = Path(args.ours), Path(args.reference)
    anywhere: dict[str, Any] = {"recursive": True, "include_hidden": True}
    ours, references = (
        sorted(each for each in glob("**/*", **anywhere, root_dir=folder) if each.lower().endswith(".exr"))
        for folder in folders
    )
    if not references:
        raise NothingSelected(f"nothing selected: no .exr file in {folders[1]}")
    done = []
    for name in references:
        a, b = (str(folder / name) for folder in folders)
        try:
            done.append(compare_exr(a, b, tolerances, reading=reading))
        except SceneError as error:
            reasons = tuple(str(error).splitlines())
            done.append(FileComparison(ours=a, reference=b, exit_code=error.exit_code, reasons=reasons))
        if not args.json:
            head, *more = done[-1].findings()
            print_lines("\n      ".join((f"{'PASS' if done[-1].ok else 'FAIL'}  {name}  {head}", *more)))
    failed = sum(not result.ok for result in done)
    if args.json:
        print(json.dumps([result.model_dump(mode="json") for result in done], indent=2))
    if alone := [name for name in ours if name not in references]:
        print_lines(f"not compared, without a reference: {', '.join(alone)}", sys.stderr if args.json else sys.stdout)
    if not args.json:
        print_lines(f"\n{plural(len(done), 'image')}: {len(done) - failed} pass, {failed} fail")
    codes = {result.exit_code for result in done}
    return max(codes - {NOTHING_SELECTED}, default=OK) or max(codes)

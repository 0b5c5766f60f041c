"""`mitsuba-ref compare`, `approve` and `check`: two EXR files; approved images of scenes, written and compared."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, TextIO, TypeVar

from caster.cli.shared_arguments import InputPath, OutputFile, OutputFolder, mesh_dir_options
from caster.description.errors import SceneError
from caster.system.process import DIFFERENCES, FILE, NOTHING_SELECTED, OK
from mitsuba_ref.cli.options import add_reading, add_selection, add_timeout, reading_of, selected_entries

if TYPE_CHECKING:
    from mitsuba_ref.exr_compare.approved import Proposal
    from mitsuba_ref.runner.many_scenes import SceneEntry

# ---- compare ----

NUMBERS = {
    "depth_rtol": "of depth and position, instead of the derived bound",
    "normal_atol": "of normals, instead of the derived bound",
    "uv_atol": "of uv, instead of the derived bound",
    "color_rtol": "of every channel that is not geometry, relative",
    "color_atol": "of every channel that is not geometry, absolute",
}


def add_compare_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("ours", metavar="OURS.exr", type=InputPath)
    add("reference", metavar="REF.exr", type=InputPath)
    add("-o", "--output", metavar="DIFF.exr", type=OutputFile, help="write the differences, and a class for each pixel")
    for name, what in NUMBERS.items():
        add(f"--{name.replace('_', '-')}", type=float, metavar="TOL", help=f"tolerance {what}")
    add("--max-pixels", type=int, default=0, metavar="N", help="number of pixels that may differ (never by NaN or inf)")
    ignore = "leave a channel or group of them out"
    add("--ignore", type=str, action="append", default=[], metavar="CHANNEL", help=ignore)
    add("--other-scene", action="store_true", help="compare images of different scenes, too")
    add("--json", action="store_true", help="as JSON")
    add = add_reading(parser)
    add("--scene", metavar="SCENE", type=InputPath, help="the scene whose camera rendered the images")


def run_compare(args: argparse.Namespace) -> int:
    """Print the comparison; 0 pass, 1 differences, 3 not comparable, 5 nothing to compare."""
    from dataclasses import replace

    from caster.scene.files import load_scene
    from mitsuba_ref.exr_compare.two_files import Tolerances, compare_exr

    names = (*NUMBERS, "max_pixels", "other_scene")
    tolerances = Tolerances(**{name: getattr(args, name) for name in names}, ignore=tuple(args.ignore))
    reading = replace(reading_of(args), scene=load_scene(args.scene) if args.scene else None)
    result = compare_exr(args.ours, args.reference, tolerances, diff=args.output, reading=reading)
    print(result.model_dump_json(indent=2) if args.json else result.format_table())
    return result.exit_code


# ---- approved images: approve and check ----


def add_approve_arguments(parser: argparse.ArgumentParser) -> None:
    add_references(parser, OutputFolder)
    add_timeout(parser)
    parser.add_argument("--yes", action="store_true", help="write the images; without it, changes are only shown")


def add_check_arguments(parser: argparse.ArgumentParser) -> None:
    add_references(parser, InputPath)
    parser.add_argument("--json", action="store_true", help="as JSON")


def add_references(parser: argparse.ArgumentParser, folder: type[str]) -> None:
    """Add the options of both: scenes, and the folder of approved images."""
    add_selection(parser)
    references = "the folder of approved images, NAME.exr for each scene"
    parser.add_argument("--references", metavar="DIR", type=folder, required=True, help=references)


T = TypeVar("T")


def each_scene(
    args: argparse.Namespace, of: Callable[[SceneEntry], T], failed: Callable[[SceneEntry, tuple[str, ...]], T]
) -> Iterator[T]:
    """The results of `of` for all selected scenes in order, or of `failed` where it raises. Raises SceneError."""
    from mitsuba_ref.runner.many_scenes import map_in_order, problem_of

    def result_of(entry: SceneEntry) -> T:
        try:
            return of(entry)
        except (SceneError, MemoryError) as error:
            return failed(entry, tuple(problem_of(error).splitlines()))

    yield from map_in_order(result_of, selected_entries(args), args.workers)


# ---- approve ----


def run_approve(args: argparse.Namespace) -> int:
    """Show changes, and write images with --yes; 0 all is as approved, 1 not approved or Mitsuba failed, 5 nothing was
    selected."""
    folder = Path(args.references)
    from caster.system.atomic_files import check_folder
    from mitsuba_ref.exr_compare.approved import Proposal, propose, write_approved
    from mitsuba_ref.reference import variants

    variants.require_variants()  # its errors come before any work
    out = sys.stdout  # itself: readers of EXR files in other threads replace sys.stdout while they read
    found = []
    for proposal in each_scene(
        args,
        lambda entry: propose(entry.load(), entry.name, entry.path, folder, args.timeout),
        lambda entry, lines: Proposal(entry.name, folder / f"{entry.name}.exr", "failed", False, lines),
    ):
        found.append(proposal)
        print_proposal(proposal, out)
    if not found:
        return NOTHING_SELECTED
    wanted = [proposal for proposal in found if proposal.write]
    failed = sum(proposal.status == "failed" for proposal in found)
    print(f"\n{len(found)} scenes: {len(wanted)} images to write, {failed} without an answer of Mitsuba")
    if wanted and not args.yes:
        print("nothing was written: look at the changes above, then add --yes", file=sys.stderr)
        return DIFFERENCES
    check_folder(folder)
    for proposal in wanted:
        assert proposal.fresh is not None  # whatever is to be written was rendered
        write_approved(proposal.path, proposal.fresh)
        print(f"wrote    {proposal.path}")
    return DIFFERENCES if failed else OK


def print_proposal(proposal: Proposal, out: TextIO) -> None:
    mark = "->" if proposal.write else "  "
    head, *rest = proposal.details or ("",)
    print(f"{proposal.status:<8} {mark} {proposal.name}  {head}".rstrip(), file=out)
    for line in rest:
        print(f"            {line}", file=out)
    out.flush()


# ---- check ----


def run_check(args: argparse.Namespace) -> int:
    """Print a row for each scene; 0 all pass, 1 some do not, 4 only missing or unreadable images fail, 5 nothing was
    selected."""
    from mitsuba_ref.exr_compare.approved import ImageCheck, ImageChecks, check_scene
    from mitsuba_ref.report.results import print_lines

    folder, out = Path(args.references), sys.stdout  # itself: readers in other threads replace sys.stdout
    found = []
    for checked in each_scene(
        args,
        lambda entry: check_scene(entry.load(), entry.name, folder / f"{entry.name}.exr"),
        lambda entry, lines: ImageCheck(entry.name, str(folder / f"{entry.name}.exr"), False, lines),
    ):
        found.append(checked)
        if not args.json:
            print_lines("\n".join(checked.lines()), out)
    if not found:
        return NOTHING_SELECTED
    failed = [checked for checked in found if not checked.ok]
    if args.json:
        print(json.dumps(ImageChecks(tuple(found)).to_dict(), indent=1))
    else:
        missing = sum(checked.missing for checked in failed)
        counts = f"{len(found) - len(failed)} pass, {len(failed) - missing} fail"
        unchecked = f", {missing} not checked: no image that can be read" if missing else ""
        print(f"\n{len(found)} scenes: {counts}{unchecked}")
        if any(checked.refused for checked in failed):
            print(f"to look at the changes and approve them: {approve_command(args)}")
    if not failed:
        return OK
    return FILE if all(checked.missing for checked in failed) else DIFFERENCES


def approve_command(args: argparse.Namespace) -> str:
    """The command that shows the changes of the same scenes, and writes them once they are approved."""
    size = ["--size", *map(str, args.size)] if args.size else []
    chosen = ["-k", args.expression] if args.expression else []
    words = [*args.scenes, "--references", args.references, *size, *chosen, *mesh_dir_options(args)]
    return shlex.join(["mitsuba-ref", "approve", *words])

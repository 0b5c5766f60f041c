"""`mitsuba-ref compare`, `approve` and `check`: two EXR files; reference EXRs, written once approved, then compared."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from caster.cli.shared_arguments import InputPath, OutputFile, OutputFolder, mesh_dir_options
from caster.description.errors import SceneError
from caster.system.process import DIFFERENCES, FILE, NOTHING_SELECTED, OK
from mitsuba_ref.cli.options import add_reading, add_selection, add_timeout, selected_entries

if TYPE_CHECKING:
    from mitsuba_ref.exr_compare.approval import Proposal, ReferenceCheck
    from mitsuba_ref.runner.many_scenes import Entry, SceneSource

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
    add("--max-pixels", type=int, default=0, metavar="N", help="so many pixels may differ (never by NaN or inf)")
    add(
        "--ignore",
        type=str,
        action="append",
        default=[],
        metavar="CHANNEL",
        help="leave a channel or group of them out",
    )
    add("--other-scene", action="store_true", help="compare images of different scenes, too")
    add("--allow-empty", action="store_true", help="two images that hit nothing pass")
    add("--json", action="store_true", help="as JSON")
    add = add_reading(parser)
    add("--scene", metavar="SCENE", type=InputPath, help="the scene whose camera rendered the images")


def run_compare(args: argparse.Namespace) -> int:
    """Print the comparison; 0 pass, 1 differences, 3 not comparable, 5 nothing to compare."""
    from mitsuba_ref.exr_compare.two_files import Reading, Tolerances, compare_exr

    numbers = {name: getattr(args, name) for name in NUMBERS}
    tolerances = Tolerances(
        **numbers,
        max_pixels=args.max_pixels,
        ignore=tuple(args.ignore),
        allow_empty=args.allow_empty,
        other_scene=args.other_scene,
    )
    scene = None
    if args.scene:
        from caster.scene.files import load_scene

        scene = load_scene(args.scene)
    reading = Reading(tuple(args.map), args.depth, args.miss, args.near, scene)
    result = compare_exr(args.ours, args.reference, tolerances, diff=args.output, reading=reading)
    print(result.model_dump_json(indent=2) if args.json else result.format_table())
    return result.exit_code


# ---- reference EXRs: approve and check ----

# Stated here as well, since loading the approval loads the kernels (tests/unit/test_cli_help.py compares).
MODES = ("missing", "changed", "all")
MAX_NAMES_IN_COMMAND = 4  # more are not listed in the command that approves them


def add_approve_arguments(parser: argparse.ArgumentParser) -> None:
    add_references(parser, OutputFolder)
    add_timeout(parser)
    parser.add_argument(
        "--update",
        choices=MODES,
        default="changed",
        help="missing: only where there is none; changed, the default: also those that have changed or are stale; "
        "all: also those whose pixels are the same, but not the versions they name",
    )
    parser.add_argument("--yes", action="store_true", help="write without confirmation; required without a terminal")


def add_check_arguments(parser: argparse.ArgumentParser) -> None:
    add_references(parser, InputPath)
    add = parser.add_argument
    add("--fresh", action="store_true", help="compare a fresh render of Mitsuba, to the bit, instead of ours")
    may = "so many pixels of a scene may differ (never by NaN or inf)"
    add("--max-pixels", type=int, default=0, metavar="N", help=may)
    add("--json", action="store_true", help="as JSON")


def add_references(parser: argparse.ArgumentParser, folder: type[str]) -> None:
    """What both share: scenes, the folder of references, the variant."""
    add_selection(parser)
    add = parser.add_argument
    references = "the folder of reference EXRs, NAME.exr for each scene"
    add("--references", metavar="DIR", type=folder, required=True, help=references)
    add("--variant", type=str, metavar="V", help="scalar_rgb or llvm_ad_rgb; default: what suits the scene")


def selection(args: argparse.Namespace) -> list[SceneSource]:
    """The selected scenes. Raises SceneError, also for an unknown variant."""
    if args.variant:
        from mitsuba_ref.reference.variants import VARIANT_NAMES, VariantError

        if args.variant not in VARIANT_NAMES:
            raise VariantError(f"--variant {args.variant!r}: expected {' or '.join(VARIANT_NAMES)}")
    return selected_entries(args)


# ---- approve ----


def run_approve(args: argparse.Namespace) -> int:
    """Show changes, confirm, write; 0 all is as approved, 1 not approved or Mitsuba failed, 5 nothing was selected."""
    entries = selection(args)
    if not entries:
        return NOTHING_SELECTED
    folder = Path(args.references)
    from caster.system.atomic_files import check_folder
    from mitsuba_ref.exr_compare.approval import Proposal, propose, unused_references
    from mitsuba_ref.exr_compare.approved_reference import render_fresh
    from mitsuba_ref.runner.many_scenes import map_in_order, problem_of

    def proposal_of(entry: Entry) -> Proposal:
        command = approve_command(args, entry.path)
        try:
            scene = entry.load().scene
            render = partial(render_fresh, variant=args.variant, command=command, timeout=args.timeout)
            return propose(scene, entry.name, entry.path, folder, args.update, render)
        except (SceneError, MemoryError) as error:
            return Proposal(
                entry.name, folder / f"{entry.name}.exr", "failed", False, tuple(problem_of(error).splitlines())
            )

    out = sys.stdout  # itself: readers of EXR files in other threads replace sys.stdout while they read
    found = []
    for proposal in map_in_order(proposal_of, entries, args.workers):
        found.append(proposal)
        print_proposal(proposal, out)
    for name in unused_references(folder, {entry.name for entry in entries}) if not args.expression else ():
        print(f"note     {name}: no scene of this selection has this name; it is left as it is")
    wanted = [proposal for proposal in found if proposal.write]
    failed = sum(proposal.status == "failed" for proposal in found)
    print(f"\n{len(found)} scenes: {len(wanted)} references to write, {failed} without an answer of Mitsuba")
    if wanted and not approved(args, len(wanted)):
        return DIFFERENCES
    check_folder(folder)
    for proposal in wanted:
        assert proposal.fresh is not None  # whatever is to be written was rendered
        proposal.fresh.write(proposal.path)
        print(f"wrote    {proposal.path}")
    return DIFFERENCES if failed else OK


def print_proposal(proposal: Proposal, out: TextIO) -> None:
    mark = "->" if proposal.write else "  "
    head, *rest = proposal.details or ("",)
    print(f"{proposal.status:<8} {mark} {proposal.name}  {head}".rstrip(), file=out)
    for line in rest:
        print(f"            {line}", file=out)
    out.flush()


def approved(args: argparse.Namespace, count: int) -> bool:
    """Whether --yes is given, or the user at the terminal confirms."""
    if args.yes:
        return True
    if not (sys.stdin and sys.stdin.isatty()):
        print(
            "nothing was written: no terminal to confirm at; look at the changes above, then add --yes", file=sys.stderr
        )
        return False
    print(f"write {count} references? [y/N] ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip().lower() in ("y", "yes"):
        return True
    print("nothing was written", file=sys.stderr)
    return False


def approve_command(args: argparse.Namespace, path: str) -> str:
    """The command that renders this reference, without folders, which differ between machines."""
    size = f" --size {args.size[0]} {args.size[1]}" if args.size else ""
    variant = f" --variant {args.variant}" if args.variant else ""
    return f"mitsuba-ref approve {Path(path).name}{size}{variant}"


# ---- check ----


def run_check(args: argparse.Namespace) -> int:
    """A row for each scene; 0 all pass, 1 some do not, 4 some have no reference that can be read, and no other fails,
    5 nothing was selected."""
    entries = selection(args)
    if not entries:
        return NOTHING_SELECTED
    from caster.system.atomic_files import ScratchFolder
    from mitsuba_ref.exr_compare.approval import ReferenceCheck, ReferenceChecks, check_scene
    from mitsuba_ref.report.results import print_lines
    from mitsuba_ref.runner.many_scenes import map_in_order, problem_of

    with ScratchFolder() as scratch:

        def check_of(entry: Entry) -> ReferenceCheck:
            path = Path(args.references) / f"{entry.name}.exr"
            options = args.variant, args.fresh, args.max_pixels
            try:
                scene = entry.load().scene
                return check_scene(scene, entry.name, entry.path, path, Path(scratch), *options)
            except (SceneError, MemoryError) as error:
                return ReferenceCheck(entry.name, str(path), False, tuple(problem_of(error).splitlines()))

        out = sys.stdout  # itself: readers of EXR files in other threads replace sys.stdout while they read
        found = []
        for checked in map_in_order(check_of, entries, args.workers):
            found.append(checked)
            if not args.json:
                print_lines("\n".join(checked.lines()), out)
    failed = [checked for checked in found if not checked.ok]
    if args.json:
        print(json.dumps(ReferenceChecks(tuple(found)).to_dict(), indent=1))
    else:
        missing = sum(checked.missing for checked in failed)
        counts = f"{len(found) - len(failed)} pass, {len(failed) - missing} fail"
        unchecked = f", {missing} not checked: no reference that can be read" if missing else ""
        print(f"\n{len(found)} scenes: {counts}{unchecked}")
        for line in approval_hint(args, failed):
            print(line)
    return check_exit_code(failed)


def check_exit_code(failed: Sequence[ReferenceCheck]) -> int:
    """A difference takes precedence over a missing file; either is no pass."""
    if not failed:
        return OK
    return FILE if all(checked.missing for checked in failed) else DIFFERENCES


def approval_hint(args: argparse.Namespace, failed: Sequence[ReferenceCheck]) -> Iterator[str]:
    """The command that shows the changes, and writes them once they are approved."""
    words = ["mitsuba-ref", "approve", *args.scenes, "--references", args.references]
    words += ["--size", *map(str, args.size)] if args.size else []
    words += ["--variant", args.variant] if args.variant else []
    words += mesh_dir_options(args)
    names = [checked.name for checked in failed if checked.refused]
    if names:
        short = len(names) <= MAX_NAMES_IN_COMMAND and all(map(is_one_word, names))
        words += ["-k", " or ".join(names)] if short else []
        yield f"to look at the changes and approve them: {shlex.join(words)}"


def is_one_word(name: str) -> bool:
    """Whether -k reads a name as one word."""
    return not any(c.isspace() or c in "()" for c in name) and name not in ("and", "or", "not")

"""`mitsuba-ref compare`, `approve` and `check`: two EXR files; approved images of scenes, written and compared."""

import argparse
import shlex
import sys
from dataclasses import replace
from pathlib import Path

from caster.description.errors import SceneError
from caster.scene.files import load_scene
from caster.system.atomic_files import check_folder
from caster.system.process import DIFFERENCES, FILE, NOTHING_SELECTED, OK
from caster.system.terminal import folded
from mitsuba_ref.cli.arguments import NUMBERS
from mitsuba_ref.cli.options import given_words, reading_of, report_address
from mitsuba_ref.cli.validate import selected_entries
from mitsuba_ref.exr_compare.approved import ImageChecks, Proposal, check_scene, propose, write_approved
from mitsuba_ref.exr_compare.comparison_result import FileComparison
from mitsuba_ref.exr_compare.two_files import Tolerances, compare_exr
from mitsuba_ref.reference import variants
from mitsuba_ref.report.builtin_scenes import shown_path
from mitsuba_ref.report.results import plural, print_lines
from mitsuba_ref.runner.engine import map_in_order
from mitsuba_ref.runner.many_scenes import SceneEntry, problem_of

# ---- compare ----


def run_compare(args: argparse.Namespace) -> int:
    """Print the comparison; 0 pass, 1 differences, 3 not comparable, 5 nothing to compare."""
    names = (*NUMBERS, "max_pixels", "other_scene")
    tolerances = Tolerances(**{name: getattr(args, name) for name in names}, ignore=tuple(args.ignore))
    reading = replace(reading_of(args), scene=load_scene(args.scene) if args.scene else None)
    result = compare_exr(args.ours, args.reference, tolerances, diff=args.output, html=args.html, reading=reading)
    print(result.model_dump_json(indent=2) if args.json else folded(result.format_table()))
    if args.html and not args.json:
        none = "report:     none, as nothing could be compared; an earlier one there is removed"
        print(f"\n{report_address(result.html) if result.html else none}")
    return result.exit_code


# ---- approve ----


def run_approve(args: argparse.Namespace) -> int:
    """Show changes, and write images with --yes; 0 all is as approved, 1 not approved or Mitsuba failed, 5 nothing was
    selected."""
    folder = Path(args.references)

    variants.require_variants()  # its errors come before any work
    out = sys.stdout  # itself: readers of EXR files in other threads replace sys.stdout while they read
    found = []

    def proposed(entry: SceneEntry) -> Proposal:
        try:
            return propose(entry.load(), entry.name, entry.path, folder, args.timeout)
        except (SceneError, MemoryError) as error:
            lines = tuple(problem_of(error).splitlines())
            return Proposal(entry.name, folder / f"{entry.name}.exr", "failed", lines)

    for proposal in map_in_order(proposed, selected_entries(args), args.workers):
        found.append(proposal)
        mark, lines = "  " if proposal.fresh is None else "->", proposal.details or ("",)
        print(f"{proposal.status:<8} {mark} {proposal.name}  {lines[0]}".rstrip(), file=out)
        for line in lines[1:]:
            print(f"            {line}", file=out)
        out.flush()
    if not found:
        return NOTHING_SELECTED
    wanted = [(proposal.path, proposal.fresh) for proposal in found if proposal.fresh is not None]
    failed = sum(proposal.status == "failed" for proposal in found)
    counts = f"{plural(len(wanted), 'image')} to write, {failed} without an answer of Mitsuba"
    print(f"\n{plural(len(found), 'scene')}: {counts}")
    if wanted and not args.yes:
        print("nothing was written: look at the changes above, then add --yes", file=sys.stderr)
        return DIFFERENCES
    check_folder(folder)
    for path, image in wanted:
        write_approved(path, image)
        print(f"wrote    {path}")
    return DIFFERENCES if failed else OK


# ---- check ----


def run_check(args: argparse.Namespace) -> int:
    """Print a row for each scene; 0 all pass, 1 some do not, 4 only missing or unreadable images fail, 5 nothing was
    selected."""
    folder, out = Path(args.references), sys.stdout  # itself: readers in other threads replace sys.stdout
    size = tuple(map(str, ("--size", *args.size))) if args.size else ()
    found: list[FileComparison] = []

    def compared(entry: SceneEntry) -> FileComparison:
        reference = folder / f"{entry.name}.exr"
        try:
            result = check_scene(entry.load(), entry.name, reference)
        except (SceneError, MemoryError) as error:
            reasons = tuple(problem_of(error).splitlines())
            return FileComparison(ours=entry.name, reference=str(reference), exit_code=DIFFERENCES, reasons=reasons)
        return result.model_copy(update={"scene": (shown_path(entry.path), *size)})

    for checked in map_in_order(compared, selected_entries(args), args.workers):
        found.append(checked)
        if not args.json:
            print_lines(check_text(checked), out)
    if not found:
        return NOTHING_SELECTED
    failed = [checked for checked in found if not checked.ok]
    missing = sum(checked.exit_code == FILE for checked in failed)
    if args.json:
        print(ImageChecks(scenes=tuple(found)).model_dump_json(indent=1))
    else:
        counts = f"{len(found) - len(failed)} pass, {len(failed) - missing} fail"
        unchecked = f", {missing} not checked: no image that can be read" if missing else ""
        print(f"\n{plural(len(found), 'scene')}: {counts}{unchecked}")
        if any(not checked.groups for checked in failed):
            print(f"look at the changes and approve them:\n{approve_command(args)}")
    if not failed:
        return OK
    return FILE if len(failed) == missing else DIFFERENCES


def check_text(checked: FileComparison) -> str:
    """A row for a scene, and lines on what differs."""
    head, *rest = checked.findings()
    notes = "; ".join((head, *checked.stated))
    more = [*rest, checked.replay] if checked.replay else rest
    return "\n      ".join((f"{'PASS' if checked.ok else 'FAIL'}  {checked.ours}  {notes}", *more))


def approve_command(args: argparse.Namespace) -> str:
    """The command that shows the changes of the same scenes, and writes them once they are approved."""
    size = ["--size", *map(str, args.size)] if args.size else []
    chosen = ["-k", args.expression] if args.expression else []
    words = [*args.scenes, "--references", args.references, *size, *chosen, *given_words(args, "mesh_dir")]
    return shlex.join(["mitsuba-ref", "approve", *words])

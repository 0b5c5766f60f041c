"""`mitsuba-ref compare`, `approve` and `check`: two EXR files; approved images of scenes, written and compared."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TextIO, TypeVar

from caster.cli.shared_arguments import InputPath, OutputFile, OutputFolder, mesh_dir_options
from caster.description.errors import SceneError
from caster.system.process import DIFFERENCES, FILE, NOTHING_SELECTED, OK
from mitsuba_ref.cli.options import add_reading, add_selection, add_timeout, reading_of, selected_entries

if TYPE_CHECKING:
    from mitsuba_ref.exr_compare.approved import Proposal, ReferenceCheck
    from mitsuba_ref.runner.many_scenes import SceneEntry

# ---- compare ----

NUMBERS = {
    "depth_rtol": "of depth and position, instead of the derived bound",
    "normal_atol": "of normals, instead of the derived bound",
    "uv_atol": "of uv, instead of the derived bound",
    "color_rtol": "of every channel that is not geometry, relative",
    "color_atol": "of every channel that is not geometry, absolute",
}
MAX_PIXELS_HELP = "number of pixels that may differ (never by NaN or inf)"


def add_compare_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("ours", metavar="OURS.exr", type=InputPath)
    add("reference", metavar="REF.exr", type=InputPath)
    add("-o", "--output", metavar="DIFF.exr", type=OutputFile, help="write the differences, and a class for each pixel")
    for name, what in NUMBERS.items():
        add(f"--{name.replace('_', '-')}", type=float, metavar="TOL", help=f"tolerance {what}")
    add("--max-pixels", type=int, default=0, metavar="N", help=MAX_PIXELS_HELP)
    ignore = "leave a channel or group of them out"
    add("--ignore", type=str, action="append", default=[], metavar="CHANNEL", help=ignore)
    add("--other-scene", action="store_true", help="compare images of different scenes, too")
    add("--allow-empty", action="store_true", help="two images that hit nothing pass")
    add("--json", action="store_true", help="as JSON")
    add = add_reading(parser)
    add("--scene", metavar="SCENE", type=InputPath, help="the scene whose camera rendered the images")


def run_compare(args: argparse.Namespace) -> int:
    """Print the comparison; 0 pass, 1 differences, 3 not comparable, 5 nothing to compare."""
    from dataclasses import replace

    from caster.scene.files import load_scene
    from mitsuba_ref.exr_compare.two_files import Tolerances, compare_exr

    names = (*NUMBERS, "max_pixels", "allow_empty", "other_scene")
    tolerances = Tolerances(**{name: getattr(args, name) for name in names}, ignore=tuple(args.ignore))
    reading = replace(reading_of(args), scene=load_scene(args.scene) if args.scene else None)
    result = compare_exr(args.ours, args.reference, tolerances, diff=args.output, reading=reading)
    print(result.model_dump_json(indent=2) if args.json else result.format_table())
    return result.exit_code


# ---- approved images: approve and check ----


def add_approve_arguments(parser: argparse.ArgumentParser) -> None:
    add_references(parser, OutputFolder)
    add_timeout(parser)
    parser.add_argument("--yes", action="store_true", help="write without confirmation; required without a terminal")


def add_check_arguments(parser: argparse.ArgumentParser) -> None:
    add_references(parser, InputPath)
    add = parser.add_argument
    add("--fresh", action="store_true", help="compare a fresh render of Mitsuba, to the bit, instead of ours")
    add("--max-pixels", type=int, default=0, metavar="N", help=MAX_PIXELS_HELP)
    add("--json", action="store_true", help="as JSON")


def add_references(parser: argparse.ArgumentParser, folder: type[str]) -> None:
    """Add the options of both: scenes, the folder of approved images, the variant."""
    add_selection(parser)
    add = parser.add_argument
    references = "the folder of approved images, NAME.exr for each scene"
    add("--references", metavar="DIR", type=folder, required=True, help=references)
    add("--variant", type=str, metavar="V", help="scalar_rgb or llvm_ad_rgb; default: what suits the scene")


T = TypeVar("T")


def each_scene(
    args: argparse.Namespace, of: Callable[[SceneEntry], T], failed: Callable[[SceneEntry, tuple[str, ...]], T]
) -> Iterator[T]:
    """The result of each selected scene, or of the error that it raises, in order. Raises SceneError."""
    from mitsuba_ref.runner.many_scenes import map_in_order, problem_of

    def result_of(entry: SceneEntry) -> T:
        try:
            return of(entry)
        except (SceneError, MemoryError) as error:
            return failed(entry, tuple(problem_of(error).splitlines()))

    yield from map_in_order(result_of, args.entries, args.workers)


def selection(args: argparse.Namespace) -> list[SceneEntry]:
    """The selected scenes. Raises SceneError, also for an unknown variant."""
    if args.variant:
        from mitsuba_ref.reference.variants import VARIANT_NAMES, VariantError

        if args.variant not in VARIANT_NAMES:
            raise VariantError(f"--variant {args.variant!r}: expected {' or '.join(VARIANT_NAMES)}")
    args.entries = selected_entries(args)
    return list(args.entries)


# ---- approve ----


def run_approve(args: argparse.Namespace) -> int:
    """Show changes, confirm, write; 0 all is as approved, 1 not approved or Mitsuba failed, 5 nothing was selected."""
    entries = selection(args)
    if not entries:
        return NOTHING_SELECTED
    folder = Path(args.references)
    from caster.system.atomic_files import check_folder
    from mitsuba_ref.exr_compare.approved import Proposal, propose, render_fresh, unused_references, write_approved

    def proposal_of(entry: SceneEntry) -> Proposal:
        command = shlex.join(["mitsuba-ref", "approve", Path(entry.path).name, *film_words(args)])
        render = partial(render_fresh, variant=args.variant, command=command, timeout=args.timeout)
        return propose(entry.load(), entry.name, entry.path, folder, render)

    def failure_of(entry: SceneEntry, lines: tuple[str, ...]) -> Proposal:
        return Proposal(entry.name, folder / f"{entry.name}.exr", "failed", False, lines)

    out = sys.stdout  # itself: readers of EXR files in other threads replace sys.stdout while they read
    found = []
    for proposal in each_scene(args, proposal_of, failure_of):
        found.append(proposal)
        print_proposal(proposal, out)
    for name in unused_references(folder, {entry.name for entry in entries}) if not args.expression else ():
        print(f"note     {name}: no scene of this selection has this name; it is left as it is")
    wanted = [proposal for proposal in found if proposal.write]
    failed = sum(proposal.status == "failed" for proposal in found)
    print(f"\n{len(found)} scenes: {len(wanted)} images to write, {failed} without an answer of Mitsuba")
    if wanted and not approved(args, len(wanted)):
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


def approved(args: argparse.Namespace, count: int) -> bool:
    """Whether --yes is given, or the user at the terminal confirms."""
    if args.yes:
        return True
    if not (sys.stdin and sys.stdin.isatty()):
        print(
            "nothing was written: no terminal to confirm at; look at the changes above, then add --yes", file=sys.stderr
        )
        return False
    print(f"write {count} images? [y/N] ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip().lower() in ("y", "yes"):
        return True
    print("nothing was written", file=sys.stderr)
    return False


def film_words(args: argparse.Namespace) -> list[str]:
    """--size and --variant as they were given."""
    size = ["--size", *map(str, args.size)] if args.size else []
    return [*size, *(["--variant", args.variant] if args.variant else [])]


# ---- check ----


def run_check(args: argparse.Namespace) -> int:
    """A row for each scene; 0 all pass, 1 some do not, 4 some have no image that can be read, and no other fails,
    5 nothing was selected."""
    if not selection(args):
        return NOTHING_SELECTED
    from mitsuba_ref.exr_compare.approved import ReferenceCheck, ReferenceChecks, check_scene
    from mitsuba_ref.report.results import print_lines

    def path_of(entry: SceneEntry) -> Path:
        return Path(args.references) / f"{entry.name}.exr"

    def check_of(entry: SceneEntry) -> ReferenceCheck:
        options = args.variant, args.fresh, args.max_pixels
        return check_scene(entry.load(), entry.name, entry.path, path_of(entry), *options)

    def failure_of(entry: SceneEntry, lines: tuple[str, ...]) -> ReferenceCheck:
        return ReferenceCheck(entry.name, str(path_of(entry)), False, lines)

    out = sys.stdout  # itself: readers of EXR files in other threads replace sys.stdout while they read
    found = []
    for checked in each_scene(args, check_of, failure_of):
        found.append(checked)
        if not args.json:
            print_lines("\n".join(checked.lines()), out)
    failed = [checked for checked in found if not checked.ok]
    if args.json:
        print(json.dumps(ReferenceChecks(tuple(found)).to_dict(), indent=1))
    else:
        missing = sum(checked.missing for checked in failed)
        counts = f"{len(found) - len(failed)} pass, {len(failed) - missing} fail"
        unchecked = f", {missing} not checked: no image that can be read" if missing else ""
        print(f"\n{len(found)} scenes: {counts}{unchecked}")
        if any(checked.refused for checked in failed):
            print(f"to look at the changes and approve them: {approve_command(args, failed)}")
    if not failed:
        return OK
    return FILE if all(checked.missing for checked in failed) else DIFFERENCES


def approve_command(args: argparse.Namespace, failed: Sequence[ReferenceCheck]) -> str:
    """The command that shows the changes, and writes them once they are approved."""
    words = ["mitsuba-ref", "approve", *args.scenes, "--references", args.references]
    words += [*film_words(args), *mesh_dir_options(args)]
    names = [checked.name for checked in failed if checked.refused]
    return shlex.join([*words, *(["-k", names[0]] if len(names) == 1 and is_one_word(names[0]) else [])])


def is_one_word(name: str) -> bool:
    """Whether -k reads a name as one word."""
    return not any(c.isspace() or c in "()" for c in name) and name not in ("and", "or", "not")

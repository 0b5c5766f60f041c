"""`mitsuba-ref approve`: write reference EXRs, after showing what is new in them."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from caster.cli.exit_codes import DIFFERENCES, OK
from caster.cli.scene_arguments import add_mesh_dirs

if TYPE_CHECKING:
    from mitsuba_ref.exr_compare.approval import Proposal
    from mitsuba_ref.runner.scene_runner import SceneEntry

# Named here too, since loading what approves loads the kernels (tests/unit/test_cli_help.py compares).
MODES = ("missing", "changed", "all")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_selection(parser)
    add = parser.add_argument
    add(
        "--update",
        choices=MODES,
        default="changed",
        help="missing: only where there is none; changed, the default: those as well that have changed or are stale; "
        "all: also those whose pixels are the same, but not the versions they name",
    )
    add("--yes", action="store_true", help="write without asking; needed where no terminal can be asked")


def add_selection(parser: argparse.ArgumentParser) -> None:
    """What `check` shares: scenes, their size, the folder, the variant."""
    from mitsuba_ref.cli.validate import count

    add = parser.add_argument
    add("scenes", metavar="SCENE|DIR", nargs="*", default=["scenes"], help="default: the folder scenes")
    add(
        "--references",
        metavar="DIR",
        required=True,
        help="the folder of reference EXRs, NAME.exr for each scene",
    )
    add("-k", metavar="EXPR", dest="expression", help="scenes whose name fits, such as 'mesh and not teapot'")
    add("-j", metavar="N", dest="workers", type=count, help="scenes at a time; default: one a core")
    add("--size", nargs=2, type=int, metavar=("W", "H"), help="film in pixels, instead of the scenes' own")
    add("--variant", metavar="V", help="scalar_rgb or llvm_ad_rgb; default: what suits the scene")
    add_mesh_dirs(parser)


def run(args: argparse.Namespace) -> int:
    """Show, ask, write; 0 all is as approved, 1 not approved or Mitsuba gave no answer, 5 nothing was selected."""
    from caster.image.atomic_files import check_folder
    from mitsuba_ref.cli.check import proceed, selection

    entries, code = selection(args)
    if not entries:
        return code
    folder = Path(args.references)
    from mitsuba_ref.exr_compare.approval import propose, unused_references

    def of(entry: SceneEntry) -> Proposal:
        return propose(entry, folder, args.update, args.variant, command_of(args, entry.path))

    out = sys.stdout  # itself: readers of EXR files put another one in its place while they read
    found = []
    for proposal in proceed(of, entries, args.workers):
        found.append(proposal)
        show(proposal, out)
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


def show(proposal: Proposal, out: TextIO) -> None:
    mark = "->" if proposal.write else "  "
    head, *rest = proposal.details or ("",)
    print(f"{proposal.status:<8} {mark} {proposal.name}  {head}".rstrip(), file=out)
    for line in rest:
        print(f"            {line}", file=out)
    out.flush()


def approved(args: argparse.Namespace, count: int) -> bool:
    """By --yes, or by whoever sits at the terminal."""
    if args.yes:
        return True
    if not (sys.stdin and sys.stdin.isatty()):
        print(
            "nothing was written: nobody to ask here; look at the changes above, then add --yes",
            file=sys.stderr,
        )
        return False
    print(f"write {count} references? [y/N] ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip().lower() in ("y", "yes"):
        return True
    print("nothing was written", file=sys.stderr)
    return False


def command_of(args: argparse.Namespace, path: str) -> str:
    """What makes this one again, without folders: it is recorded, and every machine is to write the same bytes."""
    size = f" --size {args.size[0]} {args.size[1]}" if args.size else ""
    variant = f" --variant {args.variant}" if args.variant else ""
    return f"mitsuba-ref approve {Path(path).name}{size}{variant}"
